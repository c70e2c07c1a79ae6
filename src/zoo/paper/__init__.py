"""What only the reproduction of Paun et al. 2020 needs."""

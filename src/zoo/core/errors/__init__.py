"""Error models: what stands between a forward model's series and the measured ones."""

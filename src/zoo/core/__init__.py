"""What knows no blood: data, forward models, effects, errors, inference, posteriors, diagnosis."""

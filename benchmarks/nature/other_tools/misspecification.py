"""sbi's neural posterior of the base's parameters, and its test whether the base can be right at all.

NPE with its defaults (a masked autoregressive flow) behind a fully connected embedding of the series, trained
on draws of the priors and of a white noise of unknown size; the test compares the record with simulated ones
by the maximum mean discrepancy, of the samples and of their embedding. The held-out record is computed at the
posterior's mean. References: sbi, doi 10.21105/joss.07754; Schmitt et al. 2023, arXiv 2112.08866.
"""

from __future__ import annotations

import numpy as np
import torch
from benchmarks.nature.other_tools import SEED, Answer, Array, Record, Series
from sbi.diagnostics.misspecification import calc_misspecification_mmd
from sbi.inference import NPE
from sbi.neural_nets import posterior_nn
from sbi.neural_nets.embedding_nets import FCEmbedding
from torch.distributions import Independent, Normal

PACKAGES = ("sbi", "torch")
SIMULATIONS, DRAWS, SHUFFLES = 1000, 1000, 500


def train(record: Record, part: Series) -> tuple[NPE, torch.Tensor, torch.Tensor, Array]:
    """Trained inference, simulations (n, n_times), measured series (1, n_times), and the posterior's mean."""
    rng = np.random.default_rng(SEED)
    torch.manual_seed(SEED)
    u = rng.standard_normal((SIMULATIONS, len(record.priors) + 1))
    noise = part.measured.std() * np.exp(u[:, -1] + np.log(0.03))  # 3 % of the series' sd, by a factor of e
    x = np.array([record.compute(part, one) for one in u[:, :-1]])
    x = torch.tensor(x + noise[:, None] * rng.standard_normal(x.shape), dtype=torch.float32)
    seen = torch.tensor(part.measured[None, :], dtype=torch.float32)
    prior = Independent(Normal(torch.zeros(u.shape[1]), 1.0), 1)
    net = posterior_nn("maf", embedding_net=FCEmbedding(x.shape[1]))
    inference = NPE(prior, density_estimator=net, show_progress_bars=False)
    inference.append_simulations(torch.tensor(u, dtype=torch.float32), x).train()
    draws = inference.build_posterior().sample((DRAWS,), x=seen, show_progress_bars=False)
    return inference, x, seen, draws.mean(dim=0).numpy()[:-1].astype(float)


def answer(record: Record) -> Answer:
    """Train, test, and compute the held-out record, trained for it where its parameters may be others."""
    inference, x, seen, u = train(record, record.fitted)
    p = [
        calc_misspecification_mmd(seen, x, inference, mode=mode, n_shuffle=SHUFFLES, max_samples=SHUFFLES)[0]
        for mode in ("x_space", "embedding")
    ]
    wrong = "misspecified" if min(p) < 0.05 else "not misspecified"
    if record.refit:
        u = train(record, record.held_out)[-1]
    return Answer(f"{wrong}: p = {p[0]:.2g}, {p[1]:.2g} of the embedding", record.compute(record.held_out, u))

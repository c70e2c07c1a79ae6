"""Effects on the errors, which are no part of a solve."""

from __future__ import annotations

from zoo.blood.effects.catalogue import CATALOGUE
from zoo.core.effects import Effect, EffectParameter

CATALOGUE.add(
    Effect(
        "correlated-noise",
        family="noise",
        statement="The errors of neighbouring samples are alike.",
        equation="cov(e(t), e(t + d)) = sd^2 exp(-|d|/length) or sd^2 exp(-(d/length)^2/2), around the beat",
        source="Kennedy & O'Hagan 2001, doi 10.1111/1467-9868.00294",
        signature="smooth wiggles without a cause; part of the errors, not of a solve",
        parameters=(
            EffectParameter("sd", "mmHg", 0.5, 0.0, 5.0, (0.1,), "a few times the noise of a good catheter"),
            EffectParameter(
                "length",
                "s",
                0.003,
                0.0002,
                0.03,
                (0.003,),
                "from a few samples to the length of an upstroke",
                centre=0.003,
                zero_is_base=False,
            ),
        ),
        apply=None,
    )
)

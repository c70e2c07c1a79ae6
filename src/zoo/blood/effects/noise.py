"""Effects on the errors, which are no part of a solve."""

from __future__ import annotations

from zoo.blood.effects.catalogue import CATALOGUE
from zoo.blood.effects.measures import BEATS
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
                0.027,
                0.0018,
                0.27,
                (0.027,),
                "from a few samples of the beat to the length of an upstroke",
                centre=0.027,
                zero_is_base=False,
                measure=BEATS,
            ),
        ),
        apply=None,
    )
)

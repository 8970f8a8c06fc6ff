"""Figure 11: posterior of Object 1's materials from a recording with the geometry of 17 October 2020."""

from __future__ import annotations

from inversion import corner_figure, inverted, posterior
from publish import Made, publish


def make() -> Made:
    result = inverted(1)
    numbers = {
        "rows": len(result.recording),
        "chi2_per_dof": result.fit.chi2 / result.fit.dof,
        "converged": result.converged,
        "parameters": posterior(1),
    }
    return numbers, corner_figure(1)


if __name__ == "__main__":
    publish(__file__, make)

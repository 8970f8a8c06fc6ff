"""Figure 12: posterior of Object 2's materials from a recording with the geometry of 25 February 2019."""

from __future__ import annotations

from inversion import corner_figure, inverted, posterior
from publish import Made, publish


def make() -> Made:
    result = inverted(2)
    draws = dict(zip(result.names, result.posterior.flat.numpy().T, strict=True)) if result.posterior else {}
    product = (1 - draws["body.r_spec"]) * draws["body.r_diff"]
    numbers = {
        "rows": len(result.recording),
        "chi2_per_dof": result.fit.chi2 / result.fit.dof,
        "converged": result.converged,
        "parameters": posterior(2),
        "body_diffuse_product": {
            "median": float(sorted(product)[len(product) // 2]),
            "relative_sd": float(product.std() / product.mean()),
        },
        "relative_sd_of_body.r_diff": float(draws["body.r_diff"].std() / draws["body.r_diff"].mean()),
    }
    return numbers, corner_figure(2)


if __name__ == "__main__":
    publish(__file__, make)

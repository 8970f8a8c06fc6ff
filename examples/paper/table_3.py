"""Table 3: the paper's materials, and what simulated recordings of the same nights give back of them."""

from __future__ import annotations

from inversion import inverted, posterior
from publish import Made, publish


def make() -> Made:
    numbers = {
        f"object_{number}": {"parameters": posterior(number), "warnings": inverted(number).all_warnings}
        for number in (1, 2)
    }
    return numbers, None


if __name__ == "__main__":
    publish(__file__, make)

"""The posterior of Object 1 by NumPyro's NUTS, on the tables of a file: ``python -m benchmarks.nuts TABLES.npz``.

Prints one line of JSON: draws (chains, draws, 6), CPU seconds of warm-up and sampling, and of compiling.
"""

from __future__ import annotations

import json
import os
import sys
import time

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpyro.infer import MCMC, NUTS, init_to_value

jax.config.update("jax_enable_x64", True)
WARM_UP, DRAWS = 500, 2000
LOG_N_MAX = float(np.log(1e6))


def model(data: dict[str, jax.Array]) -> None:
    """Both exponents log-uniform from 1 to 1e6, each material's reflectances uniform on their triangle."""
    flux = 0.0
    for k in range(2):
        n = jnp.exp(numpyro.sample(f"log_n_{k}", dist.Uniform(0.0, LOG_N_MAX)))
        r_spec = numpyro.sample(f"r_spec_{k}", dist.Beta(1.0, 2.0))
        share = numpyro.sample(f"share_{k}", dist.Uniform(0.0, 1.0))
        r_diff = share * (1 - r_spec)
        lobe = (n + 1) * jnp.exp(jnp.maximum(n * data[f"log_half_{k}"], -690.0))
        flux += r_spec * (data[f"normal_{k}"] * lobe).sum(0) + (data[f"grazing_{k}"] * lobe).sum(0)
        flux += r_diff * (1 - r_spec) * data[f"diffuse_{k}"]
    numpyro.sample("magnitude", dist.Normal(-2.5 * jnp.log10(flux), data["error"]), obs=data["observed"])


def main(path: str) -> None:
    with np.load(path) as file:
        data = {name: jnp.asarray(file[name]) for name in file.files}
    start = data.pop("start").reshape(2, 3)
    values = {}
    for k in range(2):
        n, r_spec, r_diff = (float(one) for one in start[k])
        r_spec = min(max(r_spec, 1e-4), 1 - 1e-4)
        share = min(max(r_diff / (1 - r_spec), 1e-4), 1 - 1e-4)
        values |= {f"log_n_{k}": np.log(n), f"r_spec_{k}": r_spec, f"share_{k}": share}
    kernel = NUTS(model, init_strategy=init_to_value(values=values))
    sampler = MCMC(kernel, num_warmup=WARM_UP, num_samples=DRAWS, progress_bar=False)
    clock = time.process_time()
    MCMC(kernel, num_warmup=1, num_samples=1, progress_bar=False).run(jax.random.PRNGKey(1), data)
    compiling = time.process_time() - clock
    clock = time.process_time()
    sampler.run(jax.random.PRNGKey(0), data)
    found = sampler.get_samples()
    seconds = time.process_time() - clock
    columns = []
    for k in range(2):
        r_spec = np.asarray(found[f"r_spec_{k}"])
        columns += [
            np.exp(np.asarray(found[f"log_n_{k}"])),
            r_spec,
            np.asarray(found[f"share_{k}"]) * (1 - r_spec),
        ]
    draws = np.stack(columns, -1)[None]
    print(json.dumps({"draws": draws.tolist(), "seconds": seconds, "compiling": compiling}))


if __name__ == "__main__":
    main(sys.argv[1])

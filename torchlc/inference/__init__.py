"""From a recording to numbers: likelihood, optimiser, sampler, and what the data leave open."""

"""The stages of a light curve: what passes from one to the next, and the contract of an effect."""

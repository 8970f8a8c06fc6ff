"""From nothing to a rotation state: grids over pole, phase and period with a light of flat facets, refined with the model."""

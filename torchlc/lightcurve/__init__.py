"""The light curve as a module: scene, recording and effects brought together, and evaluated."""

"""Diagnosis: locate the mismatch between model and recording, name the missing physics, model it, prove
it."""

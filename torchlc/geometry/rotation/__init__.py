"""Attitude: modes, quaternions and rotation matrices."""

"""Small pure functions of tensors: vectors, least squares, and whether gradients follow."""

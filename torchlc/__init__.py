"""torchlc: what is it made of, and what does the model leave out? Differentiable light curves of satellites and debris."""

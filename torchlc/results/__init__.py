"""What the verbs give back."""

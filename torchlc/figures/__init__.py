"""Pictures, each from arrays or a result; no physics is computed here."""

"""Pictures, each from arrays or a result; no physics is computed here."""

from torchlc.files.libraries import matplotlib_library

matplotlib_library()

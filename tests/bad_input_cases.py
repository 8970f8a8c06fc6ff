"""All inputs that are broken, odd or merely unusual: scenes, then recordings."""

from __future__ import annotations

from tests.bad_recordings import RECORDING_CASES
from tests.bad_scenes import SCENE_CASES

CASES = SCENE_CASES + RECORDING_CASES

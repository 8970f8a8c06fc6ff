"""The commands, one file each; importing this package registers them in the order that ``torchlc --help`` shows."""

from importlib import import_module

ORDER = (
    "simulate",
    "predict",
    "fit",
    "diagnose",
    "rotation",
    "campaign",
    "effects",
    "period",
    "materials",
    "init",
    "demo",
)

for _name in ORDER:
    import_module(f"{__name__}.{_name}")

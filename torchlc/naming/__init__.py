"""Names: whose a number is, and which class a name in a scene stands for."""

from torchlc.naming.origins import ENTRY, NOBODY, Origin, Role, full_names
from torchlc.naming.registry import Registry, Replaced, import_modules

__all__ = ["ENTRY", "NOBODY", "Origin", "Registry", "Replaced", "Role", "full_names", "import_modules"]

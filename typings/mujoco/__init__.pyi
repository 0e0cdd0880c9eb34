# MuJoCo ships its names in compiled modules without types; everything is Any here.
from typing import Any

def __getattr__(name: str) -> Any: ...

# PyTorch is optional, and checks are the same without it; everything is Any here.
from typing import Any, TypeAlias

Tensor: TypeAlias = Any

def __getattr__(name: str) -> Any: ...

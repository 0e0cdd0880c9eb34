# OpenCV is optional, and its own stubs lack half of aruco; everything is Any here.
from typing import Any

def __getattr__(name: str) -> Any: ...

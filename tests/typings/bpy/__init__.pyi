# Blender's modules carry no types: every name of theirs is untyped, here and in the modules beside this one.
from typing import Any

def __getattr__(name: str) -> Any: ...

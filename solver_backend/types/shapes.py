"""Define array types that state their shape. Equal names in a signature mean equal sizes.

``*batch`` is any number of dimensions, and ``#`` marks broadcast ones (jaxtyping's notation). Type checkers see only
the array. Nothing is checked at run time, unless jaxtyping was imported before this module, as the tests do.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if not TYPE_CHECKING and "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Int, Num
else:
    from typing import Annotated as Bool
    from typing import Annotated as Float
    from typing import Annotated as Int
    from typing import Annotated as Num

__all__ = ["Array", "Bool", "Float", "Int", "Num"]

Array = Any  # A NumPy array or a torch tensor.

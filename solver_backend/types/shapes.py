"""Array types that say their shape, as in ``Float[Array, "*batch 3"]``; a name stands for one size in a signature.

``*batch`` is any number of dimensions and ``#`` marks one that is broadcast (Kidger 2022, jaxtyping). Type checkers read
the array's type alone. Nothing is checked at run time either, unless jaxtyping was imported first, as the tests do.
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

Array = Any
"""A NumPy array or a torch tensor."""

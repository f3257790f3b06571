"""Whether the arrays of a result have the shapes that its annotations say."""

import dataclasses
import typing
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int, jaxtyped


def check(result: Any) -> None:
    """Compare every annotated array of a dataclass or NamedTuple; one letter is one number throughout."""
    kind = type(result)
    names = [f.name for f in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else kind._fields
    texts = {name: getattr(kind.__annotations__[name], "__forward_arg__", kind.__annotations__[name]) for name in names}
    written = {name: text for name, text in texts.items() if "Array," in text}
    assert written, kind
    with jaxtyped("context"):
        for name, text in written.items():
            value = getattr(result, name)
            array = np.ndarray if isinstance(value, np.ndarray) else jax.Array
            wanted = eval(text, {"Array": array, "Float": Float, "Int": Int})
            assert isinstance(value, wanted), (kind.__name__, name, text, typing.cast(Any, value).shape)

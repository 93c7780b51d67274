# SPDX-License-Identifier: GPL-2.0-or-later
"""Arrow values of Python's without pandas, which pa.scalar, pa.array and from_pylist import where it is installed.

That takes as long as to write a flight of half an hour. What converts captures makes its values here.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
from pyarrow import json as arrow_json

TYPES = {"q": pa.int64(), "d": pa.float64()}


def scalar(value: int | float) -> pa.Scalar:
    """Return a scalar, int64 or float64."""
    code = "q" if isinstance(value, int) else "d"
    return pa.Array.from_buffers(TYPES[code], 1, [None, pa.py_buffer(array(code, [value]))])[0]


def repeated(text: str, count: int) -> pa.Array:
    """Return a column of strings that are all this one, which is not empty."""
    data = text.encode()
    words = pa.StringArray.from_buffers(1, pa.py_buffer(array("i", (0, len(data)))), pa.py_buffer(data))
    indices = pa.Array.from_buffers(pa.int32(), count, [None, pa.py_buffer(bytes(4 * count))])
    return pa.DictionaryArray.from_arrays(indices, words)


def mask(values: Sequence[bool]) -> pa.Array:
    """Return a column of bools."""
    return pa.Array.from_buffers(pa.int8(), len(values), [None, pa.py_buffer(bytes(values))]).cast(pa.bool_())


def table_of(rows: Sequence[Mapping[str, Any]], types: Mapping[str, pa.DataType]) -> pa.Table:
    """Return a table of rows, whose times are nanoseconds; what is missing is null."""
    schema = pa.schema(list(types.items()))
    if not rows:
        return pa.Table.from_batches([], schema)
    # By way of JSON, whose reader knows no dictionaries and no integers as times.
    plain = {pa.types.is_dictionary: pa.string(), pa.types.is_timestamp: pa.int64()}
    read = [
        (each.name, next((type_ for is_it, type_ in plain.items() if is_it(each.type)), each.type)) for each in schema
    ]
    text = "\n".join(json.dumps({name: row.get(name) for name in types}) for row in rows).encode()
    options = arrow_json.ParseOptions(explicit_schema=pa.schema(read), unexpected_field_behavior="error")
    blocks = arrow_json.ReadOptions(use_threads=False, block_size=len(text) + 1)
    return arrow_json.read_json(pa.BufferReader(text), blocks, options).cast(schema)

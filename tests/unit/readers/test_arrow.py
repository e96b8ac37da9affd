"""Arrow columns from their own memory: the values of ``to_numpy``, in every type, cut and with blanks."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from attest_cli.readers.arrow import is_number, numbers

KINDS = [pa.float64(), pa.float32(), pa.int64(), pa.int32(), pa.uint8(), pa.bool_()]


def column(kind: pa.DataType, blanks: bool, parts: int) -> pa.ChunkedArray:
    rng = np.random.default_rng(5)
    chunks = []
    for _ in range(parts):
        values = [v if kind != pa.bool_() else v > 60 for v in rng.integers(0, 120, 37).tolist()]
        holed = [None if blanks and k % 7 == 3 else v for k, v in enumerate(values)]
        chunks.append(pa.array(holed, kind).slice(5, 23))
    return pa.chunked_array(chunks, kind)


@pytest.mark.parametrize("kind", KINDS, ids=str)
@pytest.mark.parametrize("parts", [0, 1, 3])
def test_numbers_are_those_of_arrow(kind: pa.DataType, parts: int) -> None:
    given = column(kind, False, parts)
    assert is_number(kind)
    assert numbers(given).tolist() == given.to_pylist()
    assert numbers(given).dtype == np.dtype(kind.to_pandas_dtype())


@pytest.mark.parametrize("kind", KINDS, ids=str)
@pytest.mark.parametrize("parts", [1, 3])
def test_blanks_are_nan(kind: pa.DataType, parts: int) -> None:
    given = column(kind, True, parts)
    assert given.null_count > 0
    wanted = [float("nan") if v is None else float(v) for v in given.to_pylist()]
    assert np.array_equal(numbers(given), wanted, equal_nan=True)


@pytest.mark.parametrize("kind", [pa.string(), pa.timestamp("ns"), pa.list_(pa.float64()), pa.decimal128(9), pa.null()])
def test_other_types_are_no_numbers(kind: pa.DataType) -> None:
    assert not is_number(kind)

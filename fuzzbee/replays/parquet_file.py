"""The rows that a CSV has, as Parquet, for tables too large for a text."""

from importlib.util import find_spec
from itertools import islice
from pathlib import Path

from drivers.output_file import written_for
from estimator.errors import InputError
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.exports import COLUMNS, rows
from fuzzbee.replays.trace import VehicleTrace

ROWS_AT_ONCE = 50_000
TEXTS = ("heading_reference",)


def require_parquet(path: Path) -> None:
    """Refuse early what cannot be written.

    Raises:
        InputError: the library is missing.
    """
    if find_spec("pyarrow") is None:
        raise InputError(f"--parquet {path}: needs pyarrow: pip install pyarrow")


def write_parquet(path: Path, trace: VehicleTrace, compared: Comparison) -> None:
    """All samples; null where something is not known.

    Raises:
        InputError: the file cannot be written.
    """
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    kinds = [(name, pa.string() if name in TEXTS else pa.float64()) for name in COLUMNS]
    schema, values = pa.schema(kinds), rows(trace, compared)
    with (
        written_for("--parquet", path) as fresh,
        fresh.open("wb") as file,
        ParquetWriter(file, schema) as writer,
    ):
        while part := list(islice(values, ROWS_AT_ONCE)):
            arrays = [
                pa.array(column, kind)
                for column, (_, kind) in zip(zip(*part, strict=True), kinds, strict=True)
            ]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))

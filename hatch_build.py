"""Tags a wheel by what it holds: compiled kernels fit one Python and one kind of machine.

They also fit one numba, that of constraints.txt, which the wheel requires.
"""

import re
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelTag(BuildHookInterface):  # type: ignore[type-arg, misc]
    """Without kernels the wheel is for any Python, and compiles the filter at its first start."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See hatchling's documentation of build hooks."""
        kernels = Path(self.root, "estimator", "kernels")
        if version == "standard" and kernels.is_dir() and any(kernels.iterdir()):
            build_data["pure_python"] = False
            build_data["infer_tag"] = True
            constraints = Path(self.root, "constraints.txt").read_text(encoding="utf-8")
            build_data["dependencies"] = re.findall(r"(?m)^numba==\S+", constraints)

"""Run in a fresh interpreter: imports every module of one side with all other installed packages hidden.

argv: JSON {packages, without, allowed}.
Prints JSON {modules, files}: all that was loaded, and the files of ours among it.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.metadata
import inspect
import json
import pkgutil
import sys


def canonical(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")


def owners() -> dict[str, set[str]]:
    """Top-level module -> distributions that install it. (Python 3.11's own mapping misses single-file extensions.)"""
    found: dict[str, set[str]] = {}
    for distribution in importlib.metadata.distributions():
        name = canonical(distribution.name)
        for path in distribution.files or []:
            top = path.parts[0] if len(path.parts) > 1 else inspect.getmodulename(path.name)
            if top and top.isidentifier():
                found.setdefault(top, set()).add(name)
    return found


class Hider(importlib.abc.MetaPathFinder):
    """Makes the packages of distributions that are not allowed look as if they were not installed."""

    def __init__(self, allowed: set[str]) -> None:
        self.hidden = {top for top, distributions in owners().items() if not distributions & allowed}

    def find_spec(self, fullname: str, path: object, target: object = None) -> None:
        if fullname.partition(".")[0] in self.hidden:
            raise ModuleNotFoundError(
                f"No module named {fullname!r} (not among this side's dependencies)", name=fullname
            )


def main() -> None:
    request = json.loads(sys.argv[1])
    sys.meta_path.insert(0, Hider(set(request["allowed"])))
    for name in request["packages"]:
        package = importlib.import_module(name)
        for module in pkgutil.walk_packages(getattr(package, "__path__", []), f"{name}."):
            if not request["without"] or not f"{module.name}.".startswith(f"{request['without']}."):
                importlib.import_module(module.name)
    tops = ("splitslam", "edge_agent", "map_service", "fpga_overlay")
    ours = [module for name, module in sys.modules.items() if name.partition(".")[0] in tops]
    files = sorted({file for module in ours if (file := getattr(module, "__file__", None))})
    print(json.dumps({"modules": sorted(sys.modules), "files": files}))


if __name__ == "__main__":
    main()

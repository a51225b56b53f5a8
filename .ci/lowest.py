"""Print the lowest version that pyproject.toml allows of each dependency, as constraints for pip.

python .ci/lowest.py > lowest.txt
"""

import re
import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LOWEST = re.compile(r"([\w-]+)(?:\[\w+\])?>=([\d.]+)[^;]*(;.*)?")

groups = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
for line in dict.fromkeys(line for group in groups for line in group):
    if found := LOWEST.fullmatch(line):
        name, version, marker = found.groups(default="")
        print(f"{name}=={version}{marker}")

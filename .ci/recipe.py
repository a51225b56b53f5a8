"""Print the recipe of a release for conda-forge: `recipe/recipe.yaml` with version and checksum of its sdist.

python .ci/recipe.py dist/sysid_trib-0.1.0.tar.gz > recipe.yaml
"""

import hashlib
import re
import sys
from pathlib import Path

RECIPE = Path(__file__).resolve().parents[1] / "recipe" / "recipe.yaml"


def main() -> None:
    """Print the recipe of the release with this sdist."""
    if len(sys.argv) != 2:
        sys.exit(str(__doc__))
    sdist = Path(sys.argv[1])
    version = sdist.name.removeprefix("sysid_trib-").removesuffix(".tar.gz")
    checksum = hashlib.sha256(sdist.read_bytes()).hexdigest()
    text = re.sub(
        r"^  version: .+$", f'  version: "{version}"', RECIPE.read_text("utf-8"), count=1, flags=re.MULTILINE
    )
    # The checksum is known only when the sdist has been built.
    print(
        re.sub(r"^(  url: .+\.tar\.gz)$", rf"\1\n  sha256: {checksum}", text, count=1, flags=re.MULTILINE),
        end="",
    )


if __name__ == "__main__":
    main()

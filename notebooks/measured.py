"""The measured records: in a folder that you have, or fetched from their public sources.

Looked for in the folder named by SYSID_TRIB_DATA, else in ../shared/data beside the project. With
SYSID_TRIB_FETCH=1 what is not there is fetched, once, and checked; nothing goes online otherwise.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

FOLDER = Path(__file__).parents[2] / "shared" / "data"
SKIPPED = (
    "The measured records are not part of this repository and {missing} not found: name their folder by "
    "SYSID_TRIB_DATA, or set SYSID_TRIB_FETCH=1 to fetch them; the cells that need them are skipped."
)


@dataclass(frozen=True)
class Source:
    """A file in a public repository, as it was at a commit."""

    repository: str
    commit: str
    path: str
    sha256: str

    @property
    def url(self) -> str:
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{quote(self.path)}"


# What can be fetched; free_swing.csv was converted from an object file of MATLAB, a part of it is the .mat.
SOURCES = {
    "single_pendulum/slice_15s_70s.mat": Source(
        "dynamicslab/MultiArm-Pendulum",
        "e99a7e13fe2adc8fc647321a156b6cb59a48a698",
        "ParameterEstimation/SinglePendulum/SinglePendulumDataForParameterEstimation.mat",
        "f3b8cdda4a6e86405ec37ff32b98be76fd37806a609cba7870628c1e40377a98",
    ),
    "string_pendulum/run_1.txt": Source(
        "tylertian123/phy180_lab",
        "8dca975a27db1c488d3e34f7a921b2b7f967a957",
        "lab3/report/lab1_data.txt",
        "15f476f5e4cfe290c1cc8515d5a3d3486fcc824d57363284fe46dcfe99c8e294",
    ),
    "roll_decay/model_test_21337.csv": Source(
        "martinlarsalbert/Prediction-of-roll-motion-using-fully-nonlinear-potential-flow-and-Ikedas-method",
        "cce8abde16a15a2ae45008e48b1bba9f4aeaaad4",
        "data/processed/roll decay KVLCC2/model_test_21337.csv",
        "ae63c90498fcc502d28f4408721d5c5490437b3d7ed9767d78a393ea9ecd2168",
    ),
}
# Each record by the files that hold it, the best first.
RECORDS = {
    "pendulum": ("single_pendulum/free_swing.csv", "single_pendulum/slice_15s_70s.mat"),
    "string": ("string_pendulum/run_1.txt",),
    "ship": ("roll_decay/model_test_21337.csv",),
}
# Driven records, which are not fetched: a file, or a folder of several.
DRIVEN = {"silverbox": "silverbox/multisine_1_to_6.csv", "frame": "friction_frame"}


def driven(record: str) -> Path | None:
    """Where a driven record is; None, and why, where it is not."""
    path = Path(os.environ.get("SYSID_TRIB_DATA", FOLDER)) / DRIVEN[record]
    if path.exists():
        return path
    print(
        f"{DRIVEN[record]} is not part of this repository and was not found: name the folder that holds it "
        "by SYSID_TRIB_DATA; the cells that need it are skipped."
    )
    return None


def files() -> dict[str, Path]:
    """The file of each record that there is; what is not there is named."""
    folder, online = (
        Path(os.environ.get("SYSID_TRIB_DATA", FOLDER)),
        os.environ.get("SYSID_TRIB_FETCH") == "1",
    )
    found = {}
    for record, names in RECORDS.items():
        here = [folder / name for name in names if (folder / name).is_file()]
        there = [name for name in names if online and name in SOURCES]
        path = here[0] if here else fetched(there[0]) if there else None
        if path is not None:
            found[record] = path
    missing = [record for record in RECORDS if record not in found]
    if missing and not online:
        print(SKIPPED.format(missing=f"({', '.join(missing)}) were" if found else "were"))
    return found


def fetched(name: str) -> Path | None:
    """The file from its source, kept in the user's cache; None, and why, if it cannot be had."""
    import pooch

    source, cache = SOURCES[name], pooch.os_cache("sysid_trib")
    pooch.get_logger().setLevel("WARNING")
    try:
        return Path(pooch.retrieve(source.url, f"sha256:{source.sha256}", fname=Path(name).name, path=cache))
    except (OSError, ValueError) as error:
        # pooch refuses a wrong checksum by a ValueError; requests' errors are those of the system.
        reason = "there is no connection to it" if isinstance(error, OSError) else "it is not the file it was"
        print(f"{name} could not be fetched, {reason}: {source.url}; the cells that need it are skipped.")
        return None

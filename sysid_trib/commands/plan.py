"""`sysid-trib plan`."""

from dataclasses import dataclass
from typing import ClassVar

from sysid_trib.commands.destination import Shown
from sysid_trib.commands.options import ConstraintOptions, DecayOptions, ModelOptions, option, with_options
from sysid_trib.errors import UsageError

RESULT = ".nc"


@dataclass(frozen=True)
class PlanOptions:
    """Which runs can be made, and what is wanted."""

    title: ClassVar[str] = "Next run"

    amplitude: str = option(
        "LOW:HIGH", "Limits of the release; default: 0.3 and 1.5 times the record's.", ":"
    )
    duration: str = option("LOW:HIGH", "Limits of the duration in s; default: half of and twice its.", ":")
    rate: float | None = option("HZ", "Sampling rate of the next run; default: the record's.")
    repeats: int = option("N", "How often the run is made.", 1, least=1)
    want: list[str] = option("FORCE=ERROR", "Standard error that is wanted: delta=0.0005; repeat.", [])


@with_options
def plan(
    *,
    given: DecayOptions,
    model: ModelOptions,
    constraint: ConstraintOptions,
    asked: PlanOptions,
    shown: Shown,
) -> None:
    """Say which run to make next: RESULT.nc of identify or discover, or records."""
    from sysid_trib.commands.terminal import working

    with working(given.records) as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.printing.planned import plan_blocks, plan_json
        from sysid_trib.results import files
        from sysid_trib.validation.findings import main_result
        from sysid_trib.validation.identify import identify
        from sysid_trib.validation.next_run import plan

        amplitude = checks.parse_window(asked.amplitude, "--amplitude", "LOW:HIGH, such as 0.05:0.8")
        duration = checks.parse_window(asked.duration, "--duration")
        wanted = checks.assigned(asked.want, "--want '{}' must be FORCE=ERROR, such as delta=0.0005.")
        shown.check(given.records)
        tell("reading")
        tree = files.load(given.records[0]) if [p.suffix for p in given.records] == [RESULT] else None
        # A record may be netCDF too.
        if tree is None or not files.kind_of(tree):
            options = checks.asked_model(model, constraint, given.system)
            decays, _ = read_decays(given, options.reference_frequency, options.contactless)
            tree = identify(decays, options.library, constraints=options.constraints.table, tell=tell)
        main = main_result(tree)
        if main is None:
            raise UsageError("No model of this result follows its record; plan wants one that does.")
        data = plan(
            tree,
            amplitude=amplitude,
            duration=duration,
            sampling_rate=asked.rate,
            repeats=asked.repeats,
            wanted=wanted,
            tell=tell,
        )
        shown.draw(lambda plots: [("plan", lambda: plots.plan(data))], tell)
    shown.say(lambda: plan_json(data), lambda: plan_blocks(data, main))

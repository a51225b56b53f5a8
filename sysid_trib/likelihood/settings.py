"""Settings of the search: each value, what it decides, and where it comes from."""

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from sysid_trib.errors import UsageError


def setting(value: Any, decides: str, source: str) -> Any:
    """A field with what it decides and where its value comes from."""
    return field(default=value, metadata={"decides": decides, "source": source})


@dataclass(frozen=True)
class Settings:
    """What decides in `discover`; `table` has the meaning and the source of each.

    Numbers that are not here are accuracies of arithmetic (steps of differences, ridges) or the layout of
    what is shown (spans, cells of the map): no name depends on them.

    Raises
    ------
    UsageError
        A level or a number of effects that is none.
    """

    level: float = setting(
        0.01, "significance level, shared by the tests of the candidates and the omnibus test", "convention"
    )
    max_effects: int = setting(4, "effects added at most", "time")
    seed: int = setting(0, "the drawing that counts independent tests", "any")
    credible: float = setting(
        0.95, "probability that a credible set holds the truth", "convention, as for 95 % intervals"
    )
    least_gain: float = setting(
        0.1, "deviance below which fits are equal: rounds have settled, no move is made", "odds of 1.05"
    )
    tolerance: float = setting(
        0.1,
        "part of its gain by which a column may be off: before its exact fit, between values of a shape, and "
        "along another motion that is as likely",
        "curvature along one path",
    )
    family_tolerance: float = setting(
        0.5, "the same of one of the family of an effect that is fitted", "its shape may be far from its grid"
    )
    fitted: int = setting(
        6,
        "candidates of a move, or in an effect's place, that are fitted",
        "sets hold hardly more than three",
    )
    pairs: int = setting(20, "pairs whose likelihood is computed along the path", "time")
    most_fits: int = setting(100, "fits, and moves, after which a search has not converged", "time")
    rounds: int = setting(12, "rounds of path and parameters in a fit", "time")
    shape_step: float = setting(
        0.1, "largest step of a shape in a round, of its range", "a cell of the grid of its values"
    )
    shape_values: int = setting(
        13, "values of a shape among several at which a candidate is screened; half of one alone", "time"
    )
    combinations: int = setting(24, "combinations of several shapes that are screened", "time")
    lines: int = setting(3, "lines of the spectrum at which a force of its own frequency is tried", "time")
    testable: float = setting(
        1e-3, "part of a column outside of the model's, below which it is not tested", "accuracy of a path"
    )
    strongest: float = setting(
        1.0, "part of the restoring force that a missing one may have", "more is no missing effect"
    )
    independent: float = setting(
        0.5, "part of an effect outside of the others, below which both nearly cancel", "half of its length"
    )
    determined: float = setting(
        30.0, "standard errors from which effects that nearly cancel are named", "development set"
    )
    refuted: float = setting(
        2.0, "errors by which the hold-out is predicted worse with a name it refutes", "Diebold, Mariano 1995"
    )
    free_residual: float = setting(
        2.0,
        "noise levels that a free motion leaves of a record at most, if nothing is to push it",
        "a guess: right models leave one",
    )
    level_rows: float = setting(
        5.0, "rows as which the noise's level counts that its spectrum gives", "its scatter between records"
    )
    ratio_step: float = setting(
        1.5, "distance of the ratios of both noises, in their logarithm", "the deviance is smooth: a spline"
    )
    samples_per_period: int = setting(
        60, "samples of a period that are kept", "a parabola over one is good to a part in a million"
    )
    points_per_period: int = setting(
        360, "points of a period at which forces are evaluated", "some act in a small part of it"
    )

    def __post_init__(self) -> None:
        if not 0.0 < self.level < 1.0:
            raise UsageError(
                f"A level of {self.level:g} is no probability; give one between 0 and 1, such as 0.01."
            )
        if self.max_effects < 0:
            raise UsageError(f"At most {self.max_effects} effects cannot be added; give 0 or more.")

    @property
    def outside_of_set(self) -> float:
        """One of two models is outside of a credible set if its evidence (-2 ln) is worse by this."""
        return 2.0 * float(np.log(self.credible / (1.0 - self.credible)))

    @property
    def far(self) -> float:
        """Threshold of one of as many models as are fitted."""
        return 2.0 * float(np.log(self.fitted / (1.0 - self.credible)))

    @property
    def tie(self) -> float:
        """Evidence (-2 ln) not worth more than a bare mention (Kass, Raftery 1995): the plainest is named."""
        return 2.0

    @staticmethod
    def table() -> list[tuple[str, str, str, str]]:
        """Name, default, what it decides and its source, of each."""
        return [
            (entry.name, f"{entry.default:g}", entry.metadata["decides"], entry.metadata["source"])
            for entry in fields(Settings)
        ]


DEFAULTS = Settings()

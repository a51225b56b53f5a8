"""Two candidates that explain together what an effect with shapes of its own does."""

from collections.abc import Sequence

from sysid_trib.discrepancy.evidence import evidence
from sysid_trib.discrepancy.exchange import deviance_of
from sysid_trib.discrepancy.fits import Fits
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.likelihood import likelihood
from sysid_trib.screening.columns_beside import each_beside
from sysid_trib.screening.in_place import pairs_in_place
from sysid_trib.screening.screen import Screening


def pairs_of(
    current: Screening, effects: tuple[str, ...], symbol: str, fits: Fits
) -> dict[tuple[str, str], float]:
    """Pairs in an effect's credible set, or likelier: their evidence over its own, the likeliest first.

    Parameters
    ----------
    current : Screening
        Of the final model.
    effects : tuple of str
        Its effects beside the start model's.
    symbol : str
        One of these: of no shape it has no pairs.
    fits : Fits

    Notes
    -----
    A force whose shape is fitted may follow the sum of two that have none: a damping of the power 2.25 beside
    a viscous one that of dry and quadratic friction. Pairs have no more parameters than the effect, and what
    either adds to the other is beyond chance.
    """
    model, settings = current.model, current.model.settings
    shapes = len(model.trials[model.columns_of(symbol)[0]].force.shape)
    here, likelier = evidence(model, effects), dict[tuple[str, str], float]()
    if not shapes:
        return {}
    scored = [
        (score, pair)
        for score, pair in sorted(pairs_in_place(current, (symbol,)))
        if sum(1 + len(current.trials[at].force.shape) for at in pair) <= 1 + shapes
    ]
    for _, pair in scored[: settings.fitted]:
        trials = [current.trials[at] for at in pair]
        if not _both_add(current, symbol, pair):
            continue
        names = (trials[0].force.symbol, trials[1].force.symbol)
        after = (*(s for s in effects if s != symbol), *names)
        worst = deviance_of(here + settings.outside_of_set, model, after, trials)
        fitted = fits.of(model, (symbol,), trials, worst)
        if fitted is None:
            continue
        excess = evidence(fitted, after) - here
        if excess < settings.outside_of_set:
            likelier[names] = excess
    return dict(sorted(likelier.items(), key=lambda scored: scored[1]))


def likelier_pair(
    current: Screening, effects: tuple[str, ...], fits: Fits, most: int
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model with a pair in an effect's place of whose credible set the effect is outside, if any.

    `most` : effects that a model may have.
    """
    settings = current.model.settings
    if len(effects) >= most:
        return None
    for symbol in effects:
        for pair, excess in pairs_of(current, effects, symbol, fits).items():
            after = (*(s for s in effects if s != symbol), *pair)
            if excess < -settings.outside_of_set and frozenset(after) not in fits.by_chance:
                return fits.kept[frozenset(after)], after
    return None


def _both_add(current: Screening, symbol: str, pair: Sequence[int]) -> bool:
    """Whether each of two trials in the place of an effect explains more beside the other than chance."""
    kept = current.model.columns_without((symbol,))
    columns = [current.first_trial + at for at in pair]
    for at, other in zip(pair, reversed(columns), strict=True):
        base = [*kept, other]
        bare = likelihood(current.products, base)
        beside = each_beside(current.products, base, [current.first_trial + at], bare)
        gain = float(bare.deviance - beside.deviance[0])
        force = current.trials[at].force
        if current.p_value_of(gain, force, float(beside.effective_rows[0])) >= current.model.settings.level:
            return False
    return True

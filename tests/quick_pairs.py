"""Two methods held against each other without simulated records, for tests that ask for something else.

The cross-check simulates some 14 records and identifies each twice, which takes most of the time. What
it says is tested by the tests with the mark `simulated_pairs`; the others take as scatter of the difference
the sum of the covariances that both methods state.
"""

import numpy as np

from sysid_trib.results.references import stated_covariance
from sysid_trib.validation import simulated_pairs

SCATTER = simulated_pairs.scatter


def stated_scatter(results, truth, kept, *, draws, seed, tell=None):
    """In the place of `scatter`: nothing is simulated."""
    covariance = sum(stated_covariance(result, kept) for result in results)
    return np.zeros(len(covariance)), covariance, draws, False


def choose(item):
    """Take the scatter that a test wants."""
    simulated_pairs.scatter = SCATTER if item.get_closest_marker("simulated_pairs") else stated_scatter

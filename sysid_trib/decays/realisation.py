"""The mode of one window of samples by the eigensystem realisation algorithm, and what noise does to it."""

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array

ComplexArray = NDArray[np.complex128]


def mode_root(part: Array) -> complex | None:
    """Factor by which the mode of a window goes on from one sample to the next; None if it does not turn."""
    from control import eigensys_realization

    size = _hankel(len(part))
    system, _ = eigensys_realization(part, r=2, m=size, n=size)
    roots = np.linalg.eigvals(system.A)
    return complex(roots[np.argmax(roots.imag)]) if np.any(roots.imag > 0.0) else None


def _hankel(length: int) -> int:
    return (length - 2) // 2


def swing(part: Array, root: complex, block: int) -> tuple[complex, float]:
    """Complex amplitude in the middle of a window, and the standard error of its size at a noise of 1."""
    exponent = np.log(root)
    mode = np.exp(exponent * (np.arange(len(part)) - 0.5 * (len(part) - 1)))
    # A mean over a block of samples is less than the motion in its middle.
    mode *= np.mean(np.exp(exponent * (np.arange(block) - 0.5 * (block - 1)) / block)).real
    design = np.stack([mode.real, -mode.imag], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    size = inverse @ (design.T @ part)
    return complex(*size), float(np.sqrt(size @ inverse @ size) / np.hypot(*size))


def influence_on_root(root: complex, weight: complex, length: int) -> ComplexArray:
    """Of unit errors of the samples on the root, to first order in the noise: (sample,).

    The samples are the real part of weight root^l, l counted from the middle. Errors of the Hankel matrices
    act on an eigenvalue by its left and right vectors, columns of pseudo-inverse Vandermonde matrices.
    """
    size = _hankel(length)
    powers = np.power.outer(np.array([root, np.conj(root)]), np.arange(size))
    left_vector = np.linalg.pinv(powers.T)[0]
    first = weight * root ** (-0.5 * (length - 1))
    both = np.convolve(left_vector, left_vector) / (0.5 * first * root)
    influence = np.zeros(length, dtype=complex)
    influence[2 : 2 + len(both)] += both
    influence[1 : 1 + len(both)] -= root * both
    return influence

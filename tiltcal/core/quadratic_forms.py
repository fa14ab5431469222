"""Covariances that are quadratic forms of a row's features, for many rows at a time.

A form is a sum over products of two features. Where all forms need the same products these are made once, and one
multiplication with a matrix does the rest, the final combination of the outputs included. Where every channel has
features of its own, each pair of channels needs few of the products only, and they are taken pair by pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np

from tiltcal.core.model import Array

_BLOCK = 1 << 17  # numbers that a step holds at once, to stay in the cache
_FEWEST, _MOST = 1 << 10, 1 << 13  # rows of a step
_COLUMNS = 256  # of one multiplication: so small that the linear algebra starts no threads for it


def pairs_of(count: int) -> list[tuple[int, int]]:
    """Every pair of outputs, in the order of the forms."""
    return list(combinations_with_replacement(range(count), 2))


class QuadraticForms:
    """Quadratic forms of features, ready for any number of rows.

    Parameters
    ----------
    moves : list of (ndarray of shape (raw, k, features), ndarray of shape (k, k))
        For each kind of error: how each of k errors moves the raw outputs, by feature, and the errors' covariance.
    lift : ndarray, shape (outputs, raw)
        From the raw outputs to those whose covariances are wanted.
    """

    def __init__(self, moves: list[tuple[Array, Array]], lift: Array) -> None:
        self.kinds, self.outputs = len(moves), len(lift)
        raw = np.array([_form(*one) for one in moves])
        lifted = np.array([_pair_lift(lift) @ form for form in raw])
        self._features = moves[0][0].shape[2]
        together = [_Group(self._features, lifted)]
        apart = list(self._apart(raw))
        few = sum(group.work for group in apart) + _pair_lift(lift).size * self.kinds < together[0].work
        self._groups = apart if few else together
        self._lift = _pair_lift(lift) if few else None
        self._count = raw.shape[1] if few else lifted.shape[1]
        self.rows = max(_FEWEST, min(_MOST, _BLOCK // max(group.size for group in self._groups)))

    def __call__(self, features: Array) -> Array:
        """Covariance of each pair of outputs, shape (kinds, pairs, n), from features of shape (features, n)."""
        n = features.shape[1]
        found = np.empty((self.kinds, self._count, n))
        for group in self._groups:
            found[:, group.chosen] = group(features)
        return found if self._lift is None else np.matmul(self._lift, found)

    def _apart(self, raw: Array) -> Iterator[_Group]:
        """The forms in groups that need the same products."""
        needed: dict[bytes, list[int]] = {}
        for pair in range(raw.shape[1]):
            needed.setdefault(np.any(raw[:, pair] != 0.0, axis=0).tobytes(), []).append(pair)
        for chosen in needed.values():
            yield _Group(self._features, raw[:, chosen], chosen)


class _Group:
    """Forms that share their products."""

    def __init__(self, features: int, forms: Array, chosen: list[int] | None = None) -> None:
        self.chosen = slice(None) if chosen is None else chosen
        first, second = np.triu_indices(features)
        used = np.flatnonzero(np.any(forms != 0.0, axis=(0, 1)))
        self._products = list(zip(first[used].tolist(), second[used].tolist(), strict=True))
        self._kinds = len(forms)
        self._matrix = forms.reshape(-1, forms.shape[2])[:, used]

    @property
    def size(self) -> int:
        """Numbers of a row that are held at once."""
        return len(self._products) + len(self._matrix)

    @property
    def work(self) -> int:
        """Multiplications for a row."""
        return len(self._products) + self._matrix.size

    def __call__(self, features: Array) -> Array:
        n = features.shape[1]
        pieces = -(-n // _COLUMNS)
        products = np.empty((len(self._products), pieces * _COLUMNS))
        products[:, n:] = 0.0
        for row, (first, second) in enumerate(self._products):
            np.multiply(features[first], features[second], out=products[row, :n])
        found = np.empty((len(self._matrix), pieces * _COLUMNS))
        np.matmul(self._matrix, _cut(products), out=_cut(found))
        return found[:, :n].reshape(self._kinds, -1, n)


def _cut(table: Array) -> Array:
    """A view of a table in pieces of few columns, shape (pieces, rows, columns)."""
    return table.reshape(len(table), -1, _COLUMNS).transpose(1, 0, 2)


def _form(moves: Array, covariance: Array) -> Array:
    """Covariance of the outputs as coefficients of the features' products: a row for each pair of outputs."""
    table = np.einsum("okf,kl,plg->opfg", moves, covariance, moves, optimize=True)
    table = table + table.transpose(0, 1, 3, 2)
    first, second = np.triu_indices(moves.shape[2])
    folded = table[:, :, first, second] * np.where(first == second, 0.5, 1.0)
    return np.asarray(folded[np.triu_indices(len(moves))])


def _pair_lift(lift: Array) -> Array:
    """What takes covariances of the raw outputs to those of the outputs, shape (pairs, raw pairs)."""
    rows = []
    for a, b in pairs_of(len(lift)):
        table = np.outer(lift[a], lift[b])
        table = table + table.T
        rows.append([table[i, j] / (2.0 if i == j else 1.0) for i, j in pairs_of(lift.shape[1])])
    return np.array(rows)

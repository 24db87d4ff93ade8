"""Code shared by the ablations: variants of the method on the twins and all available data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import catfree as cf
from benchmarks.paper import claims
from benchmarks.paper.command import Options
from benchmarks.paper.scoring import Score, pool, run
from benchmarks.paper.sequences import (
    DEVELOPMENT,
    Sequence as Data,
    real,
    scenarios,
    twin,
    without_embeddings,
)
from benchmarks.paper.table import Cell
from catfree.evaluation import Interval

# Other conditions on the same worlds, under which a claim is also tested.
ROUGH = ", rough ground"
BARE = ", no appearance"
CONDITIONS = (ROUGH, BARE)


@dataclass(frozen=True)
class Variant:
    """One row of an ablation.

    Attributes:
        name: name in the paper.
        settings: settings of the variant.
        true_rig: whether to localize with the true calibration.
    """

    name: str
    settings: cf.Settings
    true_rig: bool = False


@dataclass(frozen=True)
class Results:
    """Scores of variants in places, which are twins and other sequences.

    Attributes:
        scores: by variant and place, one score per world (seed); a place is a twin's paper column,
            followed by one of `CONDITIONS` if any, or the name of another sequence.
        others: the places that are not twins.
    """

    scores: Mapping[str, Mapping[str, Sequence[Score]]]
    others: tuple[str, ...]

    def pooled(self, variant: str, place: str) -> Score | None:
        """Pool all worlds of a place; return None if the variant did not run there."""
        worlds = self.scores[variant].get(place)
        return pool(worlds) if worlds else None

    def moda(self, variant: str, place: str) -> list[float]:
        """Return the MODA of each world."""
        return [score.moda for score in self.scores[variant][place]]

    def gain(self, first: str, second: str, place: str) -> Interval:
        """Compute MODA of one variant minus that of another in one place."""
        one, two = self.pooled(first, place), self.pooled(second, place)
        assert one is not None
        assert two is not None
        return claims.difference(one, two)

    def gains(
        self, first: str, second: str, places: Sequence[str] | None = None
    ) -> dict[str, Interval]:
        """Compute the gain in several places; None for all places where both ran."""
        if places is None:
            places = [p for p in self.scores[first] if p in self.scores[second]]
        return {place: self.gain(first, second, place) for place in places}


def evaluate(
    variants: Sequence[Variant],
    options: Options,
    *,
    columns: Sequence[str] = DEVELOPMENT,
    conditions: bool = False,
    tracking: bool = False,
    others: bool = True,
) -> Results:
    """Run every variant in every place.

    Args:
        variants: the rows.
        options: seeds, frames and data folder.
        columns: the twins, by the paper's columns.
        conditions: whether to also test the twins with a rougher ground (`ROUGH`) and without
            embeddings (`BARE`), where more hypotheses are wrong.
        tracking: whether to compute tracking metrics.
        others: whether to include scenarios and real data.

    Returns:
        The scores.
    """
    places: dict[str, list[Data]] = {}
    for column in columns:
        places[column] = [twin(column, seed, options.frames) for seed in options.seeds]
    for column in columns if conditions else ():
        places[column + ROUGH] = [
            twin(column, seed, options.frames, rough_ground=True) for seed in options.seeds
        ]
        places[column + BARE] = [without_embeddings(world) for world in places[column]]
    further = other_sequences(options) if others else []
    places |= {sequence.name: [sequence] for sequence in further}
    scores = {
        variant.name: {
            place: [
                run(s, variant.settings, true_rig=variant.true_rig, tracking=tracking)
                for s in sequences
            ]
            for place, sequences in places.items()
            if not variant.true_rig or sequences[0].true_scene is not None
        }
        for variant in variants
    }
    return Results(scores, tuple(sequence.name for sequence in further))


def other_sequences(options: Options) -> list[Data]:
    """Return scenarios and, for each real recording, the last and fullest set of boxes."""
    last: dict[str, Data] = {}
    for sequence in real(options.data):
        last[sequence.name.split(" ")[0]] = sequence
    return [*scenarios(options.data), *last.values()]


def ablation_rows(
    results: Results,
    paper: Mapping[str, Sequence[float]],
    columns: Sequence[str] = DEVELOPMENT,
    *,
    conditions: bool = False,
) -> tuple[list[str], list[list[Cell]]]:
    """Make columns and rows: each twin beside the paper's column, their mean, then all else.

    Args:
        results: the scores.
        paper: the paper's values of each variant, one per column; no entry for rows that it lacks.
        columns: the twins.
        conditions: whether to add columns for `CONDITIONS`.

    Returns:
        Names of the columns and the rows.
    """
    names = ["Variant"]
    for column in columns:
        names += [f"{column} paper", f"{column} twin"]
    if len(columns) > 1:
        names += ["Mean paper", "Mean twins"]
    further = under_conditions(columns) if conditions else []
    names += [*further, *results.others]
    rows: list[list[Cell]] = []
    for variant in results.scores:
        row: list[Cell] = [variant]
        said = paper.get(variant)
        for i, column in enumerate(columns):
            row += ["" if said is None else f"{said[i]:.2f}", cell(results, variant, column)]
        if len(columns) > 1:
            ours = [score.moda for score in _pooled(results, variant, columns)]
            row.append("" if said is None else f"{np.mean(said[: len(columns)]):.2f}")
            row.append(f"{np.mean(ours):.1f}")
        row += [cell(results, variant, place) for place in (*further, *results.others)]
        rows.append(row)
    return names, rows


def under_conditions(columns: Sequence[str]) -> list[str]:
    """Name the places of the twins under each of the conditions."""
    return [column + condition for condition in CONDITIONS for column in columns]


def cell(results: Results, variant: str, place: str) -> Cell:
    """Return MODA with its interval, or a dash if the variant did not run."""
    score = results.pooled(variant, place)
    return "-" if score is None else score.cell


def _pooled(results: Results, variant: str, columns: Sequence[str]) -> list[Score]:
    scores = [results.pooled(variant, column) for column in columns]
    return [score for score in scores if score is not None]

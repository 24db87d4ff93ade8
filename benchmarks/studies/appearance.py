"""MODA against the quality of appearance: `python -m benchmarks.studies.appearance --out results`.

The quality is the share of an embedding's variance due to the person; the rest is due to viewpoint,
camera colors and noise, in the proportions of the detector model. The expected cosine distance of
one person in two cameras is (1 - quality) times that of two people: at 0, appearance carries no
information; at 100 %, it identifies people. The detector model's default is 43 %.
"""

from benchmarks.studies.sweep import DetectorModel, Sequence, Study, detector, main, simulate

VARIES = 0.7  # share of the variance not common to all people, as in the default model


def looking_model(percent: float) -> DetectorModel:
    """Return the default detector with embeddings of this quality."""
    share = percent / 100
    rest = VARIES * (1 - share)
    return detector(identity=VARIES * share, view=0.5 * rest, camera=0.25 * rest, noise=0.25 * rest)


def looking(percent: float, seed: int, frames: int) -> Sequence:
    """Simulate a world whose embeddings tell people apart to this degree."""
    return simulate(seed, frames, detector=looking_model(percent))


STUDY = Study(
    name="appearance",
    title="Quality of appearance",
    axis="share of appearance that belongs to the person (%)",
    values=(0, 20, 43, 60, 80, 100),
    quick=(20, 80),
    sequence=looking,
)

if __name__ == "__main__":
    main(STUDY)

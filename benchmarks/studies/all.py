"""Run all studies in turn: `python -m benchmarks.studies.all --out results`."""

from benchmarks.studies import appearance, frames, misses, noise, rig, tilt
from benchmarks.studies.sweep import arguments, run

STUDIES = tuple(module.STUDY for module in (frames, noise, misses, appearance, rig, tilt))

if __name__ == "__main__":
    options = arguments(__doc__)
    for study in STUDIES:
        run(study, options)

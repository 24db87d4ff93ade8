"""From videos to tracks: stages, cache, second look, report and result folder."""

from catfree._run._run import RunOutcome as RunOutcome, run as run, run_stages as run_stages

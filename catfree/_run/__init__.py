"""From videos to tracks: stages, cache, second look, report and result folder."""

from catfree._run._result_folder import (
    read_results as read_results,
    write_results as write_results,
)
from catfree._run._run import RunOutcome as RunOutcome, run as run, run_stages as run_stages

"""Measure the pipeline, or any other system, on a dataset: predictions are written first and scored later.

`predict` runs the networks and writes a predictions file, `score` scores such a file without any network, `run` does
both and keeps nothing unless asked to; `import` reads other systems' predictions; `budget` says what each stage costs;
`sweep` tries settings of the range smoothing; `report` sets predictions side by side; `results` makes one page of
finished reports. docs/evaluation.md describes metrics, protocols and files.
"""

from __future__ import annotations

from twohands.cli.eval import budget, import_, predict, report, results, run_, score, sweep
from twohands.cli.eval.budget import Budget
from twohands.cli.eval.import_ import Import
from twohands.cli.eval.predict import Predict
from twohands.cli.eval.report import Report
from twohands.cli.eval.results import Results
from twohands.cli.eval.run_ import Run
from twohands.cli.eval.score import Score
from twohands.cli.eval.sweep import Sweep


def run(args: Predict | Score | Run | Import | Budget | Report | Sweep | Results) -> int:
    """Carry out `twohands eval`."""
    match args:
        case Predict():
            return predict.run(args)
        case Score():
            return score.run(args)
        case Run():
            return run_.run(args)
        case Import():
            return import_.run(args)
        case Budget():
            return budget.run(args)
        case Report():
            return report.run(args)
        case Sweep():
            return sweep.run(args)
        case Results():
            return results.run(args)

"""How good an estimate is: error statistics, the folder of a run, and its report."""

from touchline.evaluation.metrics import ErrorStatistics, ErrorTable, error_table
from touchline.evaluation.run import Run, evaluate
from touchline.evaluation.tum import read_tum, write_tum

__all__ = ["ErrorStatistics", "ErrorTable", "Run", "error_table", "evaluate", "read_tum", "write_tum"]

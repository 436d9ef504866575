"""How good the flux observers of a PMSM are beside the Cramér-Rao bounds of those who know
its parameters and of those who do not: with exact parameters, each tuned by one search on
some seeds and judged on others; with wrong ones; from many starts; what their claimed
deviations are worth; and what a step costs.

`--regime slow` runs one of them; what others have given before is kept.
"""

from .table import main as main

"""Rates that vary beside constant ones: observers that are tuned by one search on some
seeds and judged on 200 others. The flux of a motor that is driven from 2 to 1,000 rad/s,
reversed, and started from standstill, beside the Cramér-Rao bound; the velocities of the
leg; the fluxes of the magnetic bearing."""

from .table import main as main

# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""One self-contained HTML page about an evaluation: `write_report(path, ReportData(...))`."""

from __future__ import annotations

from adafusion.report.data import (
    AlphaTrace,
    Candidate,
    MeanAlpha,
    PairDistances,
    ProtocolFacts,
    ReportData,
    Retrieval,
    RouteView,
    SeenPlace,
    SplitCount,
    SystemResult,
)
from adafusion.report.html import write_report
from adafusion.types import Estimate

__all__ = [
    "AlphaTrace",
    "Candidate",
    "Estimate",
    "MeanAlpha",
    "PairDistances",
    "ProtocolFacts",
    "ReportData",
    "Retrieval",
    "RouteView",
    "SeenPlace",
    "SplitCount",
    "SystemResult",
    "write_report",
]

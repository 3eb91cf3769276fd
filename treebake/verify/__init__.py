"""The proof: draws a candidate next to its source as a stock glTF client does, and measures the difference."""

from treebake.verify.protocol import Figures, Level, Report, Sample, VerifySettings, verify

__all__ = ["Figures", "Level", "Report", "Sample", "VerifySettings", "verify"]

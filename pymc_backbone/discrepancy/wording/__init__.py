"""Verdicts, candidates and plans in sentences and tables."""

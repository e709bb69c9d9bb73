"""Reruns of the documents' experiments, one module each: functions of stars, seed and size that return an Experiment."""

from gss.domain.experiment import Experiment, Progress, Series, share_interval, share_text

__all__ = ["Experiment", "Progress", "Series", "share_interval", "share_text"]

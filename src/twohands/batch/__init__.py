"""Many clips: tracked by one process or many, on this machine or a cluster, from and to folders and buckets."""

from twohands.batch.tracker import ClipTracker

__all__ = ["ClipTracker"]

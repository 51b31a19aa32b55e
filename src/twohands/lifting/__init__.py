"""Other people's hand trackers: their files read, their hands placed in metres."""

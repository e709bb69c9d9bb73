"""The device interface as data: definitions, readers of dictionary files, and the dictionaries that packages share."""

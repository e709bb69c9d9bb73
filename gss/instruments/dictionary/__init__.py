"""The device interface as data: definitions, the reader of dictionary files, and the dictionaries that packages share."""

"""The pages' own files, and what goes out compressed."""

"""What happens, told to every page: each message written once, sent to all."""

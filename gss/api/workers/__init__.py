"""API worker processes and the link process behind them."""

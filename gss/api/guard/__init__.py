"""Who may come in: where a request is from, who it is, what it may do; and the headers of every answer."""

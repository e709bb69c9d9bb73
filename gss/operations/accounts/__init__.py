"""Who may do what: users, sign-in, tokens, permissions, and the record of it all."""

"""Access control: users, sign-in, tokens, permissions, and the audit log."""

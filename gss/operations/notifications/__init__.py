"""Notifications: mail and webhooks about alarms and events, until a person acknowledges them."""

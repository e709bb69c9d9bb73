"""Notifications of alarms and events by mail and webhook. Alarms escalate until a user acknowledges them."""

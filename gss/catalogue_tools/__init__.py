"""From a published catalogue to verified bytes on board. Pure."""

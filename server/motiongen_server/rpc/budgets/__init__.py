"""Budgets for what clients use, singly and together: messages, calls, event loop time and memory."""

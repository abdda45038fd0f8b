"""Queries before people, in their browsers: who is asked what, the clips, the server and its page. No torch here."""

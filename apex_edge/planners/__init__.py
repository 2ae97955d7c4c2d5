"""Planners: each proposes an index into the verified candidates, none decides and none moves."""

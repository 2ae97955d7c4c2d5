"""Host side of the servo firmware: codecs, link, arm geometry, limits, session, simulator."""

"""Who runs it offline: recordings assessed by the live core, tables, summaries, figures."""

# SPDX-License-Identifier: Apache-2.0
"""Who runs it offline: recordings assessed by the live core, tables, summaries, figures."""

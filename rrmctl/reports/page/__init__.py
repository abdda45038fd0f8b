"""One self-contained HTML page of everything a store can tell. `rrmctl.reports.page.assembly.build` makes it."""

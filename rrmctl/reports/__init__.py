"""From the store to tables and figures. Nothing heavy is imported before it is needed."""

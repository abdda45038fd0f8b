"""The store's content in the forms of other programs. Nothing heavy is imported before it is needed."""

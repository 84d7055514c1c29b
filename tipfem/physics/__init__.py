"""Physics beyond the bulk flow: what each adds to a step, and what it carries from one to the next."""

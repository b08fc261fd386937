"""What the subcommands of the command line do: each calls one function of the package and nothing else.

What a subcommand needs is imported when it runs, so that help and errors come at once.
"""

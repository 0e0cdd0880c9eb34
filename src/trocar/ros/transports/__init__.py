"""The transports: how messages of the core reach programs, one module each.

A module that `trocar sim` can serve has

- `OPTIONS`: a table for `trocar.cli.arguments.options`, a literal, since the command line reads it
  from the source without importing the module. A transport with an option that begins with --no-
  is served by default;
- `ORDER`: its place among the options;
- `open_transport(options, pages)`, which takes the values of all options by name and the web pages
  that may connect, and returns a `Transport`, or None where the options leave it off.
"""

"""The sub-commands of ``raytrace2``, a module each: ``add_arguments(parser)`` and ``run(args) -> exit status``."""

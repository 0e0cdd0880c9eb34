"""Register trocar's environments right after Gymnasium is imported.

`trocar_gymnasium.pth` imports this module when Python starts, so that `import gymnasium` alone
offers them: Gymnasium 1 has no entry points for that. It imports neither Gymnasium nor trocar.
"""

import sys


class AfterGymnasium:
    """Finder that adds the registration to the loading of Gymnasium, and does nothing else."""

    def find_spec(self, name, path, target=None):  # noqa: ARG002, D102
        if name != "gymnasium":
            return None
        from importlib.util import find_spec

        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module):
                load(module)
                from trocar.learning.ids import register

                register()

            spec.loader.exec_module = load_and_register
        return spec


if "gymnasium" not in sys.modules:
    sys.meta_path.insert(0, AfterGymnasium())

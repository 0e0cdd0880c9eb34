"""The client's side of CRTK and of the dVRK: the classes that scripts import as `crtk` and `dvrk`.

They stand on `crtk.ral` alone. Source of names and behaviour: crtk_python_client 1.4 and
dvrk_python 2.4.
"""

"""Makes vendor_codes.txt: every error and warning code that the vendor's own client knows, with its title.

    pip install xarm-python-sdk==1.18.4
    python vendor_codes.py | grep -v SDK_VERSION > vendor_codes.txt
"""

from xarm.core.config import x_code

for source, codes in [
    ("controller", x_code.ControllerErrorCodeMap),
    ("warning", x_code.ControllerWarnCodeMap),
    ("servo", x_code.ServoCodeMap),
    ("gripper", x_code.GripperErrorCodeMap),
]:
    for code in sorted(code for code in codes if isinstance(code, int) and 0 < code < 256):
        print(source, code, codes[code]["en"]["title"].strip())

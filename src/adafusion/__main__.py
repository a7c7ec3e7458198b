# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m adafusion`: the command line, for those who start processes by a module's name."""

from adafusion.cli import main

if __name__ == "__main__":
    main()

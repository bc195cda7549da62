#!/bin/sh
# SPDX-License-Identifier: AGPL-3.0-or-later
# sbatch takes nothing but a script: this one becomes the program that is given behind it (ui/slurm.c).
exec "$@"

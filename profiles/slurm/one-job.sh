#!/bin/sh
# Many small cases: the whole workflow as one job of Slurm, with processes that stay warm between the cases. From the
# folder of the project:
#
#     sbatch profiles/slurm/one-job.sh --configfile config/studies/smoke.yaml
#     sbatch --cpus-per-task=64 --time=8:00:00 profiles/slurm/one-job.sh ...
#
# At its time limit every solve leaves a checkpoint; handed in again, the job goes on from there.
#SBATCH --job-name=pdhe
#SBATCH --nodes=1
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=16
#SBATCH --mem-per-cpu=1500M
#SBATCH --time=4:00:00
#SBATCH --output=pdhe-%j.log
exec python3 run.py --cores "$SLURM_CPUS_PER_TASK" "$@"

#!/bin/bash
# Slurm on this machine alone, two nodes of one core each, started by hand as root (no systemd, no accounting, no cgroups): up.sh DIR
# Needs slurmctld, slurmd and munge (Debian: apt-get install --no-install-recommends slurmctld slurmd slurm-client munge; 22.05.8 was tried).
# Then: export SLURM_CONF=DIR/slurm.conf; sinfo. To stop it: kill $(cat DIR/run/*.pid)
set -euo pipefail
mkdir -p "$1"/{run,state,log,spool.n1,spool.n2}
dir=$(cd "$1" && pwd)
host=$(hostname -s)
memory_mb=$(($(awk '/MemTotal/{print $2}' /proc/meminfo) / 1024 * 4 / 10))

munge_folders=(/run/munge /var/log/munge /var/lib/munge)
mkdir -p "${munge_folders[@]}"
chown munge:munge "${munge_folders[@]}"
chmod 755 /run/munge
munge -n >/dev/null 2>&1 || runuser -u munge -- /usr/sbin/munged

cat >"$dir/slurm.conf" <<CONF
ClusterName=marf
SlurmctldHost=$host(127.0.0.1)
AuthType=auth/munge
CryptoType=crypto/munge
SlurmUser=root
SlurmctldPort=6817
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool.%n
SlurmctldPidFile=$dir/run/slurmctld.pid
SlurmdPidFile=$dir/run/slurmd.%n.pid
SlurmctldLogFile=$dir/log/slurmctld.log
SlurmdLogFile=$dir/log/slurmd.%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
MaxArraySize=10001
SchedulerParameters=batch_sched_delay=0,sched_interval=2
NodeName=n1 NodeHostname=$host NodeAddr=127.0.0.1 Port=6821 CPUs=1 RealMemory=$memory_mb State=UNKNOWN
NodeName=n2 NodeHostname=$host NodeAddr=127.0.0.1 Port=6822 CPUs=1 RealMemory=$memory_mb State=UNKNOWN
PartitionName=main Nodes=n1,n2 Default=YES MaxTime=INFINITE State=UP
CONF

export SLURM_CONF=$dir/slurm.conf
slurmctld
sleep 1
slurmd -N n1
slurmd -N n2
sleep 2
sinfo -N

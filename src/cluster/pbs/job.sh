#!/bin/bash
#PBS -N {name}
#PBS -j oe
#PBS -o {log}
#PBS -l select=1:ncpus={cores}:mem={memory_mb}mb
#PBS -l walltime={minutes}:00
#PBS -r y
#PBS {options}
exec {marf} exec {action} --store {store} --result {result} --scratch {scratch} --threads {cores}

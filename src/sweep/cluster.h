// The ranks of an MPI job, among which the points of a sweep are shared out as they become free.
//
// Rank 0 has the store, hands out points, stores what comes back, and computes too. A rank that falls silent (its
// process was killed, its machine is gone) loses only what it was computing: those points go to others. For the job to
// outlive a rank, Open MPI's mpirun needs --enable-recovery; without, it ends all ranks, and what is stored stays.
#pragma once

#include <memory>
#include <string>

#include "sweep/executor.h"

namespace saltus {

class SweepCluster {
 public:
  // On rank 0, ends the others' Serve; then leaves the job together with them.
  virtual ~SweepCluster() = default;

  virtual int rank() const = 0;
  virtual int size() const = 0;
  // How many of the ranks share this machine.
  virtual int ranks_here() const = 0;

  // On rank 0, before there is an executor: to be called at short intervals, lest others believe that it is gone.
  virtual void Tick() = 0;

  // On rank 0: `local` and all other ranks as one executor. Ranks that have another study are left out. `local` must
  // outlive the executor, this object too.
  virtual std::unique_ptr<SweepExecutor> Share(const SweepStudy& study, LocalExecutor* local) = 0;

  // On other ranks: computes what rank 0 asks for until it is done. False if rank 0 is gone.
  virtual bool Serve(const SweepStudy& study, LocalExecutor* local) = 0;

  // On other ranks: computes nothing; rank 0 logs why, unless the same keeps it from working too.
  virtual void Decline(const std::string& why) = 0;
};

// The job that mpirun started, or nothing if this program was started by itself. Throws InputError if it was built
// without MPI and started by mpirun. Precondition: called at most once.
std::unique_ptr<SweepCluster> JoinCluster();

}  // namespace saltus

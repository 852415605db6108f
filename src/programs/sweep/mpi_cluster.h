// SweepCluster over MPI. All calls of MPI are made here, by one thread.
#pragma once

#include <set>

#include "programs/sweep/cluster.h"

namespace saltus {

class MpiCluster : public SweepCluster {
 public:
  MpiCluster();
  ~MpiCluster() override;

  int rank() const override { return rank_; }
  int size() const override { return size_; }
  int ranks_here() const override { return ranks_here_; }
  std::unique_ptr<SweepExecutor> Share(const SweepStudy& study, LocalExecutor* local) override;
  void Serve(const SweepStudy& study, LocalExecutor* local) override;
  void Decline(const std::string& why) override;

  // On rank 0: ends the work of all others and finds out who is still there; `lost` are known not to be. Only the first
  // call does anything; no message is received after it.
  void Dismiss(const std::set<int>& lost);

 private:
  // On other ranks: waits for rank 0 to say how to leave.
  void AwaitDismissal();

  bool dismissed_ = false;
  bool complete_ = false;  // everyone is there at the end
  int rank_ = 0;
  int size_ = 1;
  int ranks_here_ = 1;
};

}  // namespace saltus

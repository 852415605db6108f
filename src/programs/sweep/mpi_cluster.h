// SweepCluster over MPI. All calls of MPI are made here, by one thread.
#pragma once

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

 private:
  int rank_ = 0;
  int size_ = 1;
  int ranks_here_ = 1;
};

}  // namespace saltus

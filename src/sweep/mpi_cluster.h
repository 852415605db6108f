// SweepCluster over MPI. All calls of MPI are made here, by one thread.
#pragma once

#include <mpi.h>

#include <chrono>
#include <list>
#include <set>
#include <string>

#include "sweep/cluster.h"

namespace saltus {

class MpiCluster : public SweepCluster {
 public:
  MpiCluster();
  ~MpiCluster() override;

  int rank() const override { return rank_; }
  int size() const override { return size_; }
  int ranks_here() const override { return ranks_here_; }
  void Tick() override;
  std::unique_ptr<SweepExecutor> Share(const SweepStudy& study, LocalExecutor* local) override;
  bool Serve(const SweepStudy& study, LocalExecutor* local) override;
  void Decline(const std::string& why) override;

  // On rank 0: ends the work of all others and finds out who is still there; `lost` are known not to be. Only the first
  // call does anything; no message is received after it.
  void Dismiss(const std::set<int>& lost);

  // Sends without waiting until it has been taken: that of a rank which is gone never is.
  void Send(int rank, int tag, std::string bytes);
  // Tells a rank that this one is there; a message to it that is under way still does so too.
  void SayAlive(int rank);

 private:
  struct Outgoing {
    int rank = 0;
    std::string bytes;
    MPI_Request request = MPI_REQUEST_NULL;
  };

  void ForgetSent();
  // Waits, but not for ever, until all has been taken.
  void SendRest();
  // On other ranks: waits for rank 0 to say how to leave.
  void AwaitDismissal();

  std::list<Outgoing> outgoing_;  // not taken yet
  std::chrono::steady_clock::time_point ticked_;
  bool rank_0_lost_ = false;
  bool dismissed_ = false;
  bool complete_ = false;  // everyone is there at the end
  int rank_ = 0;
  int size_ = 1;
  int ranks_here_ = 1;
};

}  // namespace saltus

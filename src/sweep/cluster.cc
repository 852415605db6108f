#include "sweep/cluster.h"

#include <cstdlib>

#if SALTUS_WITH_MPI
#include "sweep/mpi_cluster.h"
#endif

namespace saltus {
namespace {

// Looked for instead of starting MPI and asking it: alone, a sweep needs nothing of it.
bool StartedByMpi() {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"}) {
    if (std::getenv(name) != nullptr) return true;
  }
  return false;
}

}  // namespace

std::unique_ptr<SweepCluster> JoinCluster() {
  if (!StartedByMpi()) return nullptr;
#if SALTUS_WITH_MPI
  return std::make_unique<MpiCluster>();
#else
  throw InputError("started as an MPI job, but built without MPI; expected a build with SALTUS_WITH_MPI=ON");
#endif
}

}  // namespace saltus

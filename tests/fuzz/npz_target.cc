#include <glog/logging.h>

#include "fuzz/targets.h"
#include "output/npz.h"

namespace saltus::fuzz {
namespace {

// Bits rather than values: arrays may hold NaN.
void CheckRoundTrip(const NpyArray& array) {
  const std::string bytes = EncodeNpy(array);
  const StatusOr<NpyArray> again = DecodeNpy(bytes);
  CHECK(again.ok()) << again.status().message();
  CHECK(again->shape == array.shape);
  CHECK(EncodeNpy(*again) == bytes);
}

}  // namespace

void ReadsNpy(std::string_view bytes) {
  const StatusOr<NpyArray> array = DecodeNpy(std::string(bytes));
  if (!array.ok()) {
    CHECK(!array.status().message().empty());
    return;
  }
  CheckRoundTrip(*array);
}

void ReadsNpz(std::string_view bytes) {
  const StatusOr<NpzArrays> arrays = ReadNpz(FileWith(bytes));
  if (!arrays.ok()) {
    CHECK(!arrays.status().message().empty());
    return;
  }
  for (const auto& [name, array] : *arrays) CheckRoundTrip(array);
}

}  // namespace saltus::fuzz

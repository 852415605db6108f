#include "io/file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

namespace saltus {
namespace {

using testing::HasSubstr;

TEST(FileTest, RoundTripsBytesAndReplaces) {
  const std::string path = testing::TempDir() + "file_test.bin";
  const std::string bytes("a\0\r\n\xff", 5);
  ASSERT_TRUE(WriteFileAtomically(path, "something longer that is replaced").ok());
  ASSERT_TRUE(WriteFileAtomically(path, bytes).ok());
  const StatusOr<std::string> read = ReadFile(path);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(*read, bytes);
}

TEST(FileTest, LeavesNoTemporaryBehind) {
  const std::filesystem::path folder = testing::TempDir() + "file_test_folder";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder / "taken");
  ASSERT_TRUE(WriteFileAtomically(folder / "written", "x").ok());
  // A directory cannot be replaced by a file, so the rename fails after the write.
  EXPECT_FALSE(WriteFileAtomically(folder / "taken", "x").ok());
  int entries = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++entries;
  EXPECT_EQ(entries, 2);
}

TEST(FileTest, ErrorsNameTheFileAndTheCause) {
  const Status written = WriteFileAtomically("/no/such/folder/file", "x");
  EXPECT_THAT(written.message(), HasSubstr("/no/such/folder/file"));
  EXPECT_THAT(written.message(), HasSubstr("No such file"));
  const StatusOr<std::string> read = ReadFile("/no/such/file");
  ASSERT_FALSE(read.ok());
  EXPECT_THAT(read.status().message(), HasSubstr("No such file"));
}

TEST(FileTest, FoldersAndEndlessDevicesAreErrors) {
  const StatusOr<std::string> folder = ReadFile(testing::TempDir());
  ASSERT_FALSE(folder.ok());
  EXPECT_THAT(folder.status().message(), HasSubstr("directory"));
  const StatusOr<std::string> endless = ReadFile("/dev/zero", 1000);
  ASSERT_FALSE(endless.ok());
  EXPECT_THAT(endless.status().message(), HasSubstr("/dev/zero: has more than 1000 bytes"));
  const std::string path = testing::TempDir() + "file_test_limit";
  ASSERT_TRUE(WriteFileAtomically(path, "12345").ok());
  EXPECT_TRUE(ReadFile(path, 5).ok());
  EXPECT_FALSE(ReadFile(path, 4).ok());
}

}  // namespace
}  // namespace saltus

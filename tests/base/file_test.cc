#include "base/file.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <thread>

#include "folders.h"

namespace saltus {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

// A folder of its own for each test.
class WriteFileTest : public testing::Test {
 protected:
  WriteFileTest() : folder_(TempFile("write_file")) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~WriteFileTest() override { fs::remove_all(folder_); }

  std::string At(const std::string& name) const { return (folder_ / name).string(); }
  std::size_t Entries() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }

  fs::path folder_;
};

// A copy of a character device of the kernel, which nothing else needs. False if it cannot be made or opened here.
bool MakeDevice(const std::string& path, unsigned minor) {
  if (mknod(path.c_str(), S_IFCHR | 0600, makedev(1, minor)) != 0) return false;
  const int file = open(path.c_str(), O_WRONLY);
  if (file >= 0) close(file);
  return file >= 0;
}
constexpr unsigned kNull = 3, kFull = 7;

std::string Text(std::size_t size) {
  std::string text;
  while (text.size() < size) text += std::to_string(text.size()) + "\n";
  return text;
}

TEST(FileTest, RoundTripsBytesAndReplaces) {
  const std::string path = TempFile("file_test.bin");
  const std::string bytes("a\0\r\n\xff", 5);
  ASSERT_TRUE(WriteFile(path, "something longer that is replaced").ok());
  ASSERT_TRUE(WriteFile(path, bytes).ok());
  const StatusOr<std::string> read = ReadFile(path);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(*read, bytes);
}

TEST(FileTest, LeavesNoTemporaryBehind) {
  const std::filesystem::path folder = TempFile("file_test_folder");
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder / "taken");
  ASSERT_TRUE(WriteFile(folder / "written", "x").ok());
  // A directory cannot be replaced by a file, so the rename fails after the write.
  EXPECT_FALSE(WriteFile(folder / "taken", "x").ok());
  int entries = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++entries;
  EXPECT_EQ(entries, 2);
}

TEST(FileTest, ErrorsNameTheFileAndTheCause) {
  const Status written = WriteFile("/no/such/folder/file", "x");
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
  const std::string path = TempFile("file_test_limit");
  ASSERT_TRUE(WriteFile(path, "12345").ok());
  EXPECT_TRUE(ReadFile(path, 5).ok());
  EXPECT_FALSE(ReadFile(path, 4).ok());
}

TEST_F(WriteFileTest, FollowsLinksWhichStay) {
  fs::create_directories(folder_ / "elsewhere");
  std::ofstream(At("elsewhere/target")) << "before";
  fs::create_symlink("elsewhere/second", At("first"));
  fs::create_symlink("target", At("elsewhere/second"));
  fs::create_symlink(At("elsewhere/new"), At("dangling"));
  ASSERT_TRUE(WriteFile(At("first"), "after").ok());
  ASSERT_TRUE(WriteFile(At("dangling"), "new").ok());
  for (const char* link : {"first", "elsewhere/second", "dangling"}) EXPECT_TRUE(fs::is_symlink(At(link))) << link;
  EXPECT_TRUE(fs::is_regular_file(fs::symlink_status(At("elsewhere/target"))));
  EXPECT_EQ(*ReadFile(At("elsewhere/target")), "after");
  EXPECT_EQ(*ReadFile(At("elsewhere/new")), "new");
  EXPECT_EQ(Entries(), 3u);  // no temporary
}

TEST_F(WriteFileTest, LinksThatLeadNowhereAreErrors) {
  fs::create_symlink("second", At("first"));
  fs::create_symlink("first", At("second"));
  fs::create_symlink("no/such/folder", At("third"));
  EXPECT_THAT(WriteFile(At("first"), "x").message(), HasSubstr("symbolic links"));
  EXPECT_THAT(WriteFile(At("third"), "x").message(), HasSubstr("No such file"));
  EXPECT_EQ(Entries(), 3u);
}

// The old file lives on where it is still open, and its permissions in the new one.
TEST_F(WriteFileTest, RegularFilesAreReplacedInOneGo) {
  ASSERT_TRUE(WriteFile(At("file"), "before").ok());
  fs::permissions(At("file"), fs::perms::owner_read | fs::perms::owner_write);
  std::ifstream reader(At("file"));
  ASSERT_TRUE(WriteFile(At("file"), "after").ok());
  std::string read;
  reader >> read;
  EXPECT_EQ(read, "before");
  EXPECT_EQ(*ReadFile(At("file")), "after");
  EXPECT_EQ(fs::status(At("file")).permissions(), fs::perms::owner_read | fs::perms::owner_write);
}

TEST_F(WriteFileTest, NamesMayBeAsLongAsTheFileSystemTakes) {
  const std::string name(255, 'n');
  EXPECT_TRUE(WriteFile(At(name), "x").ok());
  EXPECT_EQ(*ReadFile(At(name)), "x");
  EXPECT_FALSE(WriteFile(At(name + "n"), "x").ok());
}

TEST_F(WriteFileTest, FifosAreWrittenThrough) {
  ASSERT_EQ(mkfifo(At("fifo").c_str(), 0600), 0);
  fs::create_symlink("fifo", At("link"));
  const std::string text = Text(1 << 20);  // more than a pipe holds
  for (const char* name : {"fifo", "link"}) {
    std::string read;
    // The writer waits for a reader that comes late.
    std::thread reader([&] { read = *ReadFile(At("fifo")); });
    const Status written = WriteFile(At(name), text, [] { return false; });
    reader.join();
    EXPECT_TRUE(written.ok()) << written.message();
    EXPECT_EQ(read, text) << name;
    EXPECT_TRUE(fs::is_fifo(At("fifo")));
  }
  EXPECT_EQ(Entries(), 2u);
}

TEST_F(WriteFileTest, AFifoThatNobodyReadsIsWaitedForUntilItIsToStop) {
  ASSERT_EQ(mkfifo(At("fifo").c_str(), 0600), 0);
  int asked = 0;
  EXPECT_THAT(WriteFile(At("fifo"), "x", [&] { return ++asked == 3; }).message(), HasSubstr("fifo: cannot write"));
  EXPECT_EQ(asked, 3);
  // Nor does a reader that does not read hold it up.
  const int reader = open(At("fifo").c_str(), O_RDONLY | O_NONBLOCK);
  ASSERT_GE(reader, 0);
  asked = 0;
  EXPECT_FALSE(WriteFile(At("fifo"), Text(1 << 20), [&] { return ++asked == 3; }).ok());
  EXPECT_EQ(asked, 3);
  close(reader);
}

// No signal: the process would be gone.
TEST_F(WriteFileTest, AReaderThatLeavesIsAnError) {
  ASSERT_EQ(mkfifo(At("fifo").c_str(), 0600), 0);
  std::thread reader([&] {
    const int file = open(At("fifo").c_str(), O_RDONLY);
    char byte;
    (void)!read(file, &byte, 1);
    close(file);
  });
  const Status written = WriteFile(At("fifo"), Text(1 << 20));
  reader.join();
  EXPECT_THAT(written.message(), HasSubstr("Broken pipe"));
}

TEST_F(WriteFileTest, DevicesAreWrittenThrough) {
  if (!MakeDevice(At("null"), kNull) || !MakeDevice(At("full"), kFull)) GTEST_SKIP() << "devices cannot be made here";
  fs::create_symlink("null", At("link"));
  EXPECT_TRUE(WriteFile(At("null"), Text(100000)).ok());
  EXPECT_TRUE(WriteFile(At("link"), Text(100000)).ok());
  EXPECT_THAT(WriteFile(At("full"), "x").message(), HasSubstr("full: cannot write: No space left"));
  for (const char* name : {"null", "full"}) EXPECT_TRUE(fs::is_character_file(fs::symlink_status(At(name)))) << name;
  EXPECT_TRUE(fs::is_symlink(At("link")));
  EXPECT_EQ(Entries(), 3u);
}

TEST_F(WriteFileTest, TerminalsAreWrittenThrough) {
  const int terminal = posix_openpt(O_RDWR | O_NOCTTY);
  if (terminal < 0 || grantpt(terminal) != 0 || unlockpt(terminal) != 0) GTEST_SKIP() << "no terminals here";
  const std::string path = ptsname(terminal);
  const int kept_open = open(path.c_str(), O_RDWR | O_NOCTTY);
  ASSERT_GE(kept_open, 0);
  ASSERT_TRUE(WriteFile(path, "to the terminal").ok());
  std::array<char, 100> read_back;
  const ssize_t size = read(terminal, read_back.data(), read_back.size());
  EXPECT_EQ(std::string(read_back.data(), static_cast<std::size_t>(std::max<ssize_t>(size, 0))), "to the terminal");
  close(kept_open);
  close(terminal);
}

TEST_F(WriteFileTest, AnythingElseIsRefused) {
  fs::create_directories(At("folder"));
  fs::create_symlink("folder", At("link"));
  const int descriptor = socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const fs::path before = fs::current_path();  // the path of a socket is short
  fs::current_path(folder_);
  std::string("socket").copy(address.sun_path, sizeof address.sun_path - 1);
  ASSERT_EQ(bind(descriptor, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  fs::current_path(before);
  EXPECT_THAT(WriteFile(At("folder"), "x").message(), HasSubstr("folder: cannot write: it is a directory"));
  EXPECT_THAT(WriteFile(At("link"), "x").message(), HasSubstr("is a directory"));
  EXPECT_THAT(WriteFile(At("socket"), "x").message(), HasSubstr("is a socket"));
  EXPECT_FALSE(WriteFile(At("folder/"), "x").ok());
  EXPECT_FALSE(WriteFile(At("new/"), "x").ok());
  EXPECT_FALSE(WriteFile("", "x").ok());
  close(descriptor);
  EXPECT_TRUE(fs::is_socket(At("socket")));
  EXPECT_EQ(Entries(), 3u);
}

// The file behind standard output may have been unlinked, and then has no name.
TEST_F(WriteFileTest, AFileWithoutANameIsRefused) {
  const int file = open(At("file").c_str(), O_RDWR | O_CREAT, 0600);
  ASSERT_GE(file, 0);
  fs::remove(At("file"));
  EXPECT_THAT(WriteFile("/proc/self/fd/" + std::to_string(file), "x").message(), HasSubstr("has no name"));
  EXPECT_EQ(Entries(), 0u);
  close(file);
}

TEST_F(WriteFileTest, AFolderThatTakesNoFilesIsAnError) {
  ASSERT_TRUE(WriteFile(At("file"), "before").ok());
  fs::permissions(folder_, fs::perms::owner_read | fs::perms::owner_exec | fs::perms::others_exec);
  // For root there are no permissions, so somebody else tries.
  const pid_t child = fork();
  if (child == 0) {
    if (getuid() == 0 && setuid(65534) != 0) _exit(3);
    const Status written = WriteFile(At("file"), "after");
    _exit(written.message().find("Permission denied") == std::string::npos ? 1 : 0);
  }
  int status = 0;
  waitpid(child, &status, 0);
  fs::permissions(folder_, fs::perms::owner_all);
  ASSERT_TRUE(WIFEXITED(status));
  if (WEXITSTATUS(status) == 3) GTEST_SKIP() << "root can become nobody else here";
  EXPECT_EQ(WEXITSTATUS(status), 0);
  EXPECT_EQ(*ReadFile(At("file")), "before");
}

TEST_F(WriteFileTest, WhatIsNoRegularFileIsNamed) {
  ASSERT_EQ(mkfifo(At("fifo").c_str(), 0600), 0);
  EXPECT_TRUE(CheckRegularFile(At("none")).ok());
  EXPECT_THAT(CheckRegularFile(At("fifo")).message(), HasSubstr("fifo: it is a FIFO, expected a regular file"));
  EXPECT_THAT(CheckRegularFile(folder_).message(), HasSubstr("is a directory"));
}

}  // namespace
}  // namespace saltus

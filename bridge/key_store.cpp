// SPDX-License-Identifier: Apache-2.0
#include "bridge/key_store.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <memory>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <openssl/bio.h>
#include <openssl/bn.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/pkcs7.h>
#include <openssl/x509v3.h>
#include <sys/stat.h>

#include "bridge/atomic_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

namespace fs = std::filesystem;
using std::chrono::sys_seconds;

template <auto free_function>
struct Free {
  template <class T>
  void operator()(T* object) const noexcept {
    free_function(object);
  }
};
using Key = std::unique_ptr<EVP_PKEY, Free<EVP_PKEY_free>>;
using Certificate = std::unique_ptr<X509, Free<X509_free>>;
using Bio = std::unique_ptr<BIO, Free<BIO_free_all>>;
using Number = std::unique_ptr<BIGNUM, Free<BN_free>>;
using Extension = std::unique_ptr<X509_EXTENSION, Free<X509_EXTENSION_free>>;
using Signature = std::unique_ptr<PKCS7, Free<PKCS7_free>>;

/// A clock that runs a little behind ours must not refuse what we have just made.
constexpr std::chrono::minutes kClockTolerance{10};
constexpr std::size_t kLongestName = 40;

/// Throws when OpenSSL refuses `what`.
void require(bool is_done, const std::string& what) {
  if (is_done) return;
  const char* reason = ERR_reason_error_string(ERR_peek_last_error());
  ERR_clear_error();
  throw InputError(what + ": " + (reason == nullptr ? "refused by OpenSSL" : reason));
}

struct Signer {
  Key key;
  Certificate certificate;
};

struct Validity {
  sys_seconds from, to;
};

Validity validity_from_now(std::chrono::days length) {
  const auto now = std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
  return {now - kClockTolerance, now + length};
}

void add_extension(X509* certificate, int id, const char* value) {
  const Extension extension{X509V3_EXT_conf_nid(nullptr, nullptr, id, value)};
  require(extension && X509_add_ext(certificate, extension.get(), -1) == 1, "certificate");
}

/// A new key with its certificate, signed by `issuer`, or by itself when that is null.
Signer make_signed(const std::string& name, Validity validity, const Signer* issuer) {
  Signer made{Key{EVP_EC_gen("P-256")}, Certificate{X509_new()}};
  X509* x509 = made.certificate.get();
  require(made.key && x509 != nullptr, "key pair");
  const Number serial{BN_new()};
  constexpr int kSerialBits = 127;  // positive and within RFC 5280's 20 bytes
  require(BN_rand(serial.get(), kSerialBits, BN_RAND_TOP_ANY, BN_RAND_BOTTOM_ANY) == 1 &&
              BN_to_ASN1_INTEGER(serial.get(), X509_get_serialNumber(x509)) != nullptr,
          "serial number");
  X509_NAME* subject = X509_get_subject_name(x509);
  const auto add_name = [subject](const char* field, const std::string& value) {
    require(X509_NAME_add_entry_by_txt(subject, field, MBSTRING_ASC,
                                       reinterpret_cast<const unsigned char*>(value.c_str()), -1,
                                       -1, 0) == 1,
            "subject " + value);
  };
  add_name("O", "Holdfast");
  add_name("CN", name);
  const Signer& by = issuer == nullptr ? made : *issuer;
  const auto time_t_of = [](sys_seconds t) { return std::chrono::system_clock::to_time_t(t); };
  require(X509_set_version(x509, X509_VERSION_3) == 1 &&
              ASN1_TIME_set(X509_getm_notBefore(x509), time_t_of(validity.from)) != nullptr &&
              ASN1_TIME_set(X509_getm_notAfter(x509), time_t_of(validity.to)) != nullptr &&
              X509_set_issuer_name(x509, X509_get_subject_name(by.certificate.get())) == 1 &&
              X509_set_pubkey(x509, made.key.get()) == 1,
          "certificate");
  // The permissions authority signs documents itself, hence its digitalSignature.
  add_extension(x509, NID_basic_constraints,
                issuer == nullptr ? "critical,CA:TRUE" : "critical,CA:FALSE");
  add_extension(
      x509, NID_key_usage,
      issuer == nullptr ? "critical,keyCertSign,digitalSignature" : "critical,digitalSignature");
  require(X509_sign(x509, by.key.get(), EVP_sha256()) > 0, "certificate");
  return made;
}

std::string text_of(const Bio& bio) {
  char* data = nullptr;
  const auto length = BIO_get_mem_data(bio.get(), &data);
  return {data, static_cast<std::size_t>(length)};
}

std::string pem(const Certificate& certificate) {
  const Bio bio{BIO_new(BIO_s_mem())};
  require(PEM_write_bio_X509(bio.get(), certificate.get()) == 1, "certificate");
  return text_of(bio);
}

std::string pem(const Key& key) {
  const Bio bio{BIO_new(BIO_s_mem())};
  require(
      PEM_write_bio_PrivateKey(bio.get(), key.get(), nullptr, nullptr, 0, nullptr, nullptr) == 1,
      "private key");
  return text_of(bio);
}

/// S/MIME, multipart/signed, as the DDS Security plugins read it.
std::string signed_document(const std::string& text, const Signer& by) {
  constexpr int kFlags = PKCS7_TEXT | PKCS7_DETACHED | PKCS7_STREAM;
  const Bio in{BIO_new_mem_buf(text.data(), static_cast<int>(text.size()))};
  const Signature signature{
      PKCS7_sign(by.certificate.get(), by.key.get(), nullptr, in.get(), kFlags)};
  const Bio out{BIO_new(BIO_s_mem())};
  require(signature && SMIME_write_PKCS7(out.get(), signature.get(), in.get(), kFlags) == 1,
          "signature");
  return text_of(out);
}

Bio open(const fs::path& file) {
  Bio bio{BIO_new_file(file.c_str(), "rb")};
  if (!bio) throw InputError(file.string() + ": cannot be read");
  return bio;
}

Certificate read_certificate(const fs::path& file) {
  Certificate certificate{PEM_read_bio_X509(open(file).get(), nullptr, nullptr, nullptr)};
  require(certificate != nullptr, file.string() + ": no certificate (PEM)");
  return certificate;
}

/// Never asks for a passphrase: a key that has one is refused.
Key read_key(const fs::path& file) {
  const auto no_passphrase = [](char*, int, int, void*) { return -1; };
  Key key{PEM_read_bio_PrivateKey(open(file).get(), nullptr, no_passphrase, nullptr)};
  require(key != nullptr, file.string() + ": no private key (PEM, without a passphrase)");
  return key;
}

sys_seconds time_of(const ASN1_TIME* time) {
  std::tm parts{};
  require(ASN1_TIME_to_tm(time, &parts) == 1, "certificate's time");
  return sys_seconds{std::chrono::seconds{timegm(&parts)}};
}

std::string subject_of(const Certificate& certificate) {
  const Bio bio{BIO_new(BIO_s_mem())};
  require(X509_NAME_print_ex(bio.get(), X509_get_subject_name(certificate.get()), 0,
                             XN_FLAG_RFC2253) >= 0,
          "subject");
  return text_of(bio);
}

/// A folder for the owner only, under another name until commit() puts it in its place.
class NewFolder {
 public:
  explicit NewFolder(const fs::path& path) : path_(path), temporary_(path.string() + ".part") {
    if (fs::exists(path_)) throw InputError(path_.string() + ": exists; keys are not replaced");
    std::error_code error;
    fs::remove_all(temporary_, error);
    fs::create_directories(path_.parent_path().empty() ? "." : path_.parent_path(), error);
    if (::mkdir(temporary_.c_str(), S_IRWXU) != 0)
      throw InputError(fmt::format("{}: cannot be made: {}", path_.string(), std::strerror(errno)));
  }
  ~NewFolder() {
    std::error_code error;
    if (!is_committed_) fs::remove_all(temporary_, error);
  }
  NewFolder(const NewFolder&) = delete;
  NewFolder& operator=(const NewFolder&) = delete;

  void write(std::string_view name, const std::string& bytes) const {
    write_file_atomically((temporary_ / name).string(), bytes);
    fs::permissions(temporary_ / name, fs::perms::owner_read | fs::perms::owner_write);
  }
  void commit() {
    fs::rename(temporary_, path_);
    is_committed_ = true;
  }

 private:
  fs::path path_, temporary_;
  bool is_committed_ = false;
};

constexpr const char* kIdentityKey = "identity_ca.key";
constexpr const char* kPermissionsKey = "permissions_ca.key";

void require_name(const std::string& name) {
  const bool is_plain = std::all_of(name.begin(), name.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '_' || c == '-';
  });
  if (name.empty() || name.size() > kLongestName || !is_plain)
    throw InputError(
        fmt::format("name '{}': 1..{} letters, digits, '_' or '-'", name, kLongestName));
}

}  // namespace

void make_authorities(const fs::path& folder, std::chrono::days validity) {
  NewFolder files{folder};
  const Validity period = validity_from_now(validity);
  const Signer identity = make_signed("identity authority", period, nullptr);
  const Signer permissions = make_signed("permissions authority", period, nullptr);
  files.write(dds::kIdentityAuthorityFile, pem(identity.certificate));
  files.write(kIdentityKey, pem(identity.key));
  files.write(dds::kPermissionsAuthorityFile, pem(permissions.certificate));
  files.write(kPermissionsKey, pem(permissions.key));
  files.commit();
}

void make_participant(const fs::path& authorities, const fs::path& folder,
                      const dds::RoleRights& rights, const std::string& name,
                      std::chrono::days validity) {
  require_name(name);
  const Signer identity{read_key(authorities / kIdentityKey),
                        read_certificate(authorities / dds::kIdentityAuthorityFile)};
  const Signer permissions{read_key(authorities / kPermissionsKey),
                           read_certificate(authorities / dds::kPermissionsAuthorityFile)};
  const Validity period = validity_from_now(validity);
  for (const Signer* authority : {&identity, &permissions})
    if (const auto end = time_of(X509_get0_notAfter(authority->certificate.get())); end < period.to)
      throw InputError(fmt::format("{}: the authorities end on {:%Y-%m-%d}, before {:%Y-%m-%d}",
                                   authorities.string(), end, period.to));
  const Signer made = make_signed(name, period, &identity);
  NewFolder files{folder};
  files.write(dds::kIdentityAuthorityFile, pem(identity.certificate));
  files.write(dds::kPermissionsAuthorityFile, pem(permissions.certificate));
  files.write(dds::kCertificateFile, pem(made.certificate));
  files.write(dds::kPrivateKeyFile, pem(made.key));
  files.write(dds::kGovernanceFile, signed_document(dds::governance_xml(), permissions));
  files.write(dds::kPermissionsFile,
              signed_document(dds::permissions_xml(rights, subject_of(made.certificate),
                                                   period.from, period.to),
                              permissions));
  files.commit();
}

Identity read_identity(const fs::path& folder) {
  const fs::path key_file = folder / dds::kPrivateKeyFile;
  const fs::path certificate_file = folder / dds::kCertificateFile;
  const Certificate authority = read_certificate(folder / dds::kIdentityAuthorityFile);
  const Certificate certificate = read_certificate(certificate_file);
  const Key key = read_key(key_file);
  constexpr auto kOthers = fs::perms::group_all | fs::perms::others_all;
  if ((fs::status(key_file).permissions() & kOthers) != fs::perms::none)
    throw InputError(key_file.string() + ": others may read it; chmod 600");
  if (X509_check_private_key(certificate.get(), key.get()) != 1) {
    ERR_clear_error();
    throw InputError(key_file.string() + ": is not the key of " + certificate_file.string());
  }
  if (X509_verify(certificate.get(), X509_get0_pubkey(authority.get())) != 1) {
    ERR_clear_error();
    throw InputError(certificate_file.string() + ": not signed by the authority beside it");
  }
  return {subject_of(certificate), time_of(X509_get0_notBefore(certificate.get())),
          time_of(X509_get0_notAfter(certificate.get()))};
}

Identity require_valid_identity(const fs::path& folder, std::chrono::system_clock::time_point now) {
  Identity identity = read_identity(folder);
  if (now < identity.not_before || now > identity.not_after)
    throw InputError(fmt::format(
        "{}: valid from {:%Y-%m-%d %H:%M} to {:%Y-%m-%d %H:%M} UTC, not now",
        (folder / dds::kCertificateFile).string(), identity.not_before, identity.not_after));
  return identity;
}

}  // namespace holdfast::bridge

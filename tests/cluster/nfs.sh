#!/bin/bash
# Inside a user-mode Linux whose root is this machine's: one NFS server, and the folder mounted twice by NFSv3 without
# locks and twice by NFSv4.2; then the tests of shared folders on both.
#     nfs.sh REPOSITORY PYTHON LOG
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
exec >"$3" 2>&1 </dev/null
mount -t proc proc /proc
for each in /run /mnt /lib/modules /var/lib/nfs; do mount -t tmpfs tmpfs "$each"; done
ln -s "/usr/lib/uml/modules/$(uname -r)" /lib/modules/
mkdir -p /run/rpcbind /var/lib/nfs/{rpc_pipefs,sm,v4recovery} /mnt/export/{v3,v4} /mnt/{one,two}/v{3,4}
touch /var/lib/nfs/{etab,rmtab,state}
modprobe -a nfsd nfsv4 nfsv3 lockd
ip link set lo up
mount -t nfsd nfsd /proc/fs/nfsd
echo 10 >/proc/fs/nfsd/nfsv4leasetime
echo 10 >/proc/fs/nfsd/nfsv4gracetime
echo 0 >/proc/sys/fs/leases-enable # both mounts are one client to NFSv4, which may trust what it has read
exportfs -o rw,no_root_squash,insecure,fsid=0,no_subtree_check 127.0.0.1:/mnt/export
rpcbind -w
sleep 0.5
rpc.mountd
rpc.nfsd 4
cd "$1" || exit
for each in one two; do
    mount -t nfs -o vers=3,nolock,nosharecache 127.0.0.1:/mnt/export/v3 /mnt/$each/v3
    mount -t nfs4 -o vers=4.2,nosharecache 127.0.0.1:/v4 /mnt/$each/v4
done
for version in v3 v4; do
    mount | grep "/mnt/one/$version "
    SHARED_FOLDER=/mnt/one/$version:/mnt/two/$version "$2" -m pytest -n 0 -q -p no:cacheprovider --basetemp=/mnt/tmp \
        tests/cluster/test_shared_folder.py -k "not two_programs" && echo "$version passed"
done
halt -f -p

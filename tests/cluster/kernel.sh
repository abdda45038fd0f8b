#!/bin/bash
# Begins a user-mode Linux whose root is this machine's.
#     kernel.sh LOG both REPOSITORY PYTHON        an NFS server, mounted twice: the tests of shared folders on NFSv3 and v4.2
#     kernel.sh LOG server ADDRESS                an NFS server of /mnt/export
#     kernel.sh LOG client ADDRESS SERVER         mounts it as /mnt/v3, without locks, and as /mnt/v4; runs what its console says
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
exec >"$1" 2>&1 </dev/null
role=$2 console=/dev/tty1
shift 2

serve() {
	mkdir -p /run/rpcbind /var/lib/nfs/{rpc_pipefs,sm,v4recovery} /mnt/export/{v3,v4}
	touch /var/lib/nfs/{etab,rmtab,state}
	modprobe -a nfsd lockd
	mount -t nfsd nfsd /proc/fs/nfsd
	echo 10 >/proc/fs/nfsd/nfsv4leasetime
	echo 10 >/proc/fs/nfsd/nfsv4gracetime
	exportfs -o rw,no_root_squash,insecure,fsid=0,no_subtree_check "*:/mnt/export"
	rpcbind -w
	sleep 0.5
	rpc.mountd
	rpc.nfsd 4
}

# SERVER FOLDER OPTIONS
attach() {
	mkdir -p "$2"/v{3,4}
	modprobe -a nfsv4 nfsv3
	mount -t nfs -o "vers=3,nolock$3" "$1:/mnt/export/v3" "$2/v3"
	mount -t nfs4 -o "vers=4.2$3" "$1:/v4" "$2/v4"
	mount | grep "$2/v"
}

mount -t proc proc /proc
for each in /run /mnt /lib/modules /var/lib/nfs; do mount -t tmpfs tmpfs "$each"; done
ln -s "/usr/lib/uml/modules/$(uname -r)" /lib/modules/
ip link set lo up
if [ "$role" = both ]; then
	echo 0 >/proc/sys/fs/leases-enable # both mounts are one client to NFSv4, which may trust what it has read
	serve
	for each in one two; do attach 127.0.0.1 "/mnt/$each" ,nosharecache; done
	cd "$1" || exit
	for version in v3 v4; do
		SHARED_FOLDER=/mnt/one/$version:/mnt/two/$version "$2" -m pytest -n 0 -q -p no:cacheprovider \
			--basetemp=/mnt/tmp tests/cluster/test_shared_folder.py -k "not two_programs" && echo "$version passed"
	done
	halt -f -p
fi
hostname "$1"
ip address add "$1/24" dev eth0
ip link set eth0 up
stty -F $console -echo -opost -isig # a line at a time: bash reads ahead of what is raw
if [ "$role" = server ]; then serve; else attach "$2" /mnt ""; fi
{
	echo ready
	while read -r -a words; do
		"${words[@]}"
		echo "exit $?"
	done
} <$console >$console
halt -f -p
